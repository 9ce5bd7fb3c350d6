"""Runs of the same seed, joined by lines: what a condition changes in each of them."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from wobblesim.analysis.comparison import ALPHA, compare
from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import (
    FAINT,
    MOST_COLUMNS,
    OKABE_ITO,
    WIDTH,
    Drawing,
    count,
    dress,
    new_figure,
    panels,
    performance_label,
)
from wobblesim.analysis.tables import Results

COLORS = {"rises": OKABE_ITO[2], "falls": OKABE_ITO[1], "equal": FAINT}
"""Of a line, by what it does from the baseline to the condition."""

COLUMNS = (
    "kind",
    "condition",
    "seed",
    "baseline",
    "baseline_performance",
    "performance",
    "difference",
    "change",
    "n_pairs",
    "rises",
    "falls",
    "missing",
    "p_holm",
    "significant",
    "effect",
)

LETTERS = 14
"""Of a title that fit into an inch."""

PANEL = 2.6
"""Height of a row of panels, inches."""


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw a panel for each condition beside the baseline, with a line for each seed and a thick one for the means.

    Both runs of a line start from the same behaviours. The means are those of the pairs drawn.

    The table has a row for each ``pair``, each seed that makes none (``missing``) and each ``condition``, told by
    ``kind``: ``condition``, ``seed``, the ``baseline`` and its ``baseline_performance``, ``performance`` and
    ``difference`` in body lengths, and ``change``: the line ``rises``, ``falls`` or is ``equal``, or why there is none.
    The row of a condition has the means, how many pairs there are (``n_pairs``), how many lines are of each kind
    (``rises``, ``falls``), how many seeds are ``missing``, and what `compare` says: ``p_holm``, ``significant`` and
    ``effect``, the rank-biserial correlation.

    Raises
    ------
    FigureError
        If there is no condition beside the baseline, or none that makes a pair with it.
    """
    table = check(results, choice)
    of_conditions = table[table["kind"] == "condition"]
    n = len(of_conditions)
    rows = -(-n // MOST_COLUMNS)
    width = max(5.6, min(n, MOST_COLUMNS) * WIDTH / MOST_COLUMNS)
    figure = new_figure(width, 1.1 + max(PANEL * rows, 3.4))
    axes = panels(figure, n, sharey=True)
    for panel, (_, mean) in zip(axes, of_conditions.iterrows(), strict=True):
        _panel(panel, table[(table["kind"] == "pair") & (table["condition"] == mean["condition"])], mean)
    for place in range(0, n, MOST_COLUMNS):
        axes[place].set_ylabel(f"final performance\n({performance_label(results)})")
    title = textwrap.fill(_title(of_conditions), round(LETTERS * width))
    figure.suptitle(title, x=0.01, ha="left", fontsize=9, color="0.3")
    return Drawing(figure, table)


def check(results: Results, choice: Choice) -> pd.DataFrame:
    """The table of `draw`, or its error."""
    reference = choice.reference(results)
    others = [name for name in choice.shown(results) if name != reference]
    if not others:
        raise FigureError(f"there is no condition beside {reference}, so that there are no pairs; show two conditions")
    found = compare(results, reference, conditions=others)
    if not found.pairs["n_pairs"].any():
        raise FigureError(f"no seed has a score in both {reference} and another condition; choose another baseline")
    runs = results.runs("condition", "seed", "performance")
    performance = runs.pivot(index="seed", columns="condition", values="performance")
    lines = pd.DataFrame([row for name in others for row in _lines(performance, reference, name)])
    missing = found.missing.rename(columns={"why": "change"})
    rows = [*lines.assign(kind="pair").to_dict("records"), *missing.assign(kind="missing").to_dict("records")]
    means = [_mean(lines[lines["condition"] == pair["condition"]], pair) for _, pair in found.pairs.iterrows()]
    table = pd.DataFrame([*rows, *means], columns=list(COLUMNS)).assign(baseline=reference)
    whole = dict.fromkeys(("seed", "n_pairs", "rises", "falls", "missing"), "Int64")
    return table.astype({**whole, "significant": "boolean"}).fillna({"change": ""})


def _lines(performance: pd.DataFrame, reference: str, condition: str) -> Iterator[dict[str, Any]]:
    """A row for each seed that has a score in both."""
    for seed, here in performance[[reference, condition]].dropna().iterrows():
        change = float(here[condition] - here[reference])
        yield {
            "condition": condition,
            "seed": seed,
            "baseline_performance": float(here[reference]),
            "performance": float(here[condition]),
            "difference": change,
            "change": "rises" if change > 0.0 else "falls" if change < 0.0 else "equal",
        }


def _mean(lines: pd.DataFrame, pair: pd.Series) -> dict[str, Any]:
    """The row of a condition; `pair` is that of `Comparison.pairs`."""
    told = ("condition", "difference", "n_pairs", "missing", "p_holm", "significant", "effect")
    counts = lines["change"].value_counts()
    return {
        "kind": "condition",
        "baseline_performance": lines["baseline_performance"].mean(),
        "performance": lines["performance"].mean(),
        "rises": int(counts.get("rises", 0)),
        "falls": int(counts.get("falls", 0)),
        **{name: pair[name] for name in told},
    }


# --- the picture ---------------------------------------------------------------------------------------------------


def _panel(axes: Axes, lines: pd.DataFrame, mean: pd.Series) -> None:
    ends = lines[["baseline_performance", "performance"]].to_numpy(dtype=np.float64)
    segments = np.stack([np.broadcast_to([0.0, 1.0], ends.shape), ends], axis=-1)
    thin = float(np.interp(len(lines), (10, 100), (1.2, 0.6)))
    axes.add_collection(
        LineCollection(
            list(segments), colors=[COLORS[change] for change in lines["change"]], linewidths=thin, alpha=0.7
        )
    )
    if len(lines) > 1:
        both = [mean["baseline_performance"], mean["performance"]]
        axes.plot([0, 1], both, color="black", linewidth=2.8, marker="o", markersize=6, solid_capstyle="round")
    axes.autoscale_view()
    dress(axes, "", "")
    axes.set_xlim(-0.18, 1.18)
    axes.set_xticks([0, 1], [wrapped(str(mean["baseline"])), wrapped(str(mean["condition"]))])
    axes.tick_params(axis="x", length=0, labelsize=8)
    axes.set_title(_said(mean), loc="left", fontsize=8, color="0.3")


def wrapped(name: str, width: int = 17) -> str:
    """The id of a condition on several lines, broken behind its underscores, or anywhere if need be."""
    parts = name.replace("_", "_ ")
    return textwrap.fill(parts, width, break_on_hyphens=False).replace("_ ", "_")


def _said(mean: pd.Series) -> str:
    n, missing = int(mean["n_pairs"]), int(mean["missing"])
    lost = f", {missing:,} missing" if missing else ""
    said = f"{count(n, 'pair')}{lost}\n{mean['rises']:,} rise, {mean['falls']:,} fall"
    if math.isnan(mean["p_holm"]):
        return said
    star = "\u2605 " if mean["significant"] else ""
    effect = "" if math.isnan(mean["effect"]) else f", effect {mean['effect']:+z.2f}".replace("-", "\u2212")
    return f"{said}\n{star}{_p(mean['p_holm'])}{effect}"


def _p(p: float) -> str:
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"


def _title(means: pd.DataFrame) -> str:
    family = int(means["p_holm"].notna().sum())
    parts = ["line: a seed; blue rises, orange falls"]
    if (means["n_pairs"] > 1).any():
        parts.append("black: mean of the pairs")
    if family:
        holm = f", Holm over {count(family, 'condition')}" if family > 1 else ""
        star = f", star: p < {ALPHA:g}" if means["significant"].any() else ""
        parts.append(f"p: Wilcoxon{holm}{star}; effect: rank-biserial correlation")
    return "; ".join(parts)
