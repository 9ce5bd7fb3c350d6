"""Final performance against exploration: how far a run searched, and how well it ended."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import (
    LEGEND_ROWS,
    MOST_LABELS,
    WIDTH,
    Drawing,
    count,
    dress,
    looks,
    new_figure,
    performance_label,
)
from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import Results

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""The baseline's first. Six for the others, who have seven colours: all pairs come in turn."""

COLUMNS = (
    "kind",
    "condition",
    "seed",
    "distance",
    "distance_half_width",
    "performance",
    "performance_half_width",
    "n",
    "excluded",
    "spearman",
    "p",
)

FEWEST = 3
"""Runs of a rank correlation."""

MOST_EXACT = 7
"""Runs up to which its p is counted over all permutations: the t distribution gives 0 for 3 runs in order."""

WIDE = 3.0
"""Search distances differ so many times where their axis is logarithmic."""

MARGIN = 0.07
"""Around the dots, as a part of their range."""

LETTERS = 14
"""Of a title that fit into an inch."""


class Correlation(NamedTuple):
    """Spearman's rank correlation."""

    spearman: float
    p: float
    n: int


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw a dot for each run, and a large mark with bars for the mean of each condition and its 99 % interval.

    The search distance is the sum of all modifications from the ancestor in epoch 0 to the last best behaviour, in the
    unit of the numbers of a behaviour. Its axis is logarithmic where the distances differ much. Runs without a score
    are counted and left out.

    The table has a row for each run, condition and for all, told by ``kind``: ``condition``, ``seed``, search
    ``distance`` and ``performance`` in body lengths, of a condition their means with ``distance_half_width`` and
    ``performance_half_width`` (99 % confidence). Of conditions and of all, ``n`` runs, how many are ``excluded``, and
    ``spearman``, the rank correlation of distance and performance, with its two-sided ``p`` (see `correlation`).

    Raises
    ------
    FigureError
        If no run that is shown has a score.
    """
    table = check(results, choice)
    reference = choice.reference(results)
    figure = new_figure(height=5.2)
    axes = figure.add_subplot()
    _limits(axes, table[table["kind"] == "run"])
    marks = _marks(axes, table, reference)
    dress(
        axes, "search distance from the first ancestor to the last behaviour",
        f"final performance\n({performance_label(results)})", grid="both",
    )  # fmt: skip
    figure.suptitle(textwrap.fill(_title(table), round(LETTERS * WIDTH)), x=0.01, ha="left", fontsize=9, color="0.3")
    _name(figure, axes, marks)
    return Drawing(figure, table)


def check(results: Results, choice: Choice) -> pd.DataFrame:
    """The table of `draw`, or its error."""
    runs = results.runs("condition", "seed", "path_before", "path_after", "performance")
    runs = runs[runs["condition"].isin(choice.shown(results))].astype({"condition": str})
    runs["distance"] = runs["path_before"] + runs["path_after"]
    scored = runs.dropna(subset="performance")
    if not len(scored):
        raise FigureError("no run that is shown has a score; choose conditions that have one")
    dots = scored[["condition", "seed", "distance", "performance"]].assign(kind="run").to_dict("records")
    of_conditions = [
        {"kind": "condition", "condition": name, **_summed(mine)}
        for name, mine in runs.groupby("condition", sort=False)
    ]
    table = pd.DataFrame([*dots, *of_conditions, {"kind": "all", **_summed(runs)}], columns=list(COLUMNS))
    return table.astype({"seed": "Int64", "n": "Int64", "excluded": "Int64"}).fillna({"condition": ""})


def _summed(runs: pd.DataFrame) -> dict[str, float]:
    scored = runs.dropna(subset="performance")
    distance, performance = (mean_of(scored[name]) for name in ("distance", "performance"))
    found = correlation(scored["distance"], scored["performance"])
    return {
        "distance": float(distance.mean),
        "distance_half_width": float(distance.half_width),
        "performance": float(performance.mean),
        "performance_half_width": float(performance.half_width),
        "excluded": len(runs) - len(scored),
        **found._asdict(),
    }


def correlation(distance: ArrayLike, performance: ArrayLike) -> Correlation:
    """Spearman's rank correlation, as of `scipy.stats.spearmanr`.

    Its p is two-sided and from Student's t; for up to `MOST_EXACT` runs, it is the share of all permutations whose
    correlation is as large.

    Parameters
    ----------
    distance, performance : (n,)
        Finite.

    Returns
    -------
    Correlation
        NaN for fewer than 3 runs, or if all distances or all performances are the same.
    """
    ranks = [stats.rankdata(values) for values in (distance, performance)]
    n = len(ranks[0])
    if n < FEWEST or any(np.ptp(rank) == 0.0 for rank in ranks):
        return Correlation(np.nan, np.nan, n)
    found = stats.spearmanr(*ranks)
    p = float(found.pvalue) if n > MOST_EXACT else _exact(*ranks)
    return Correlation(float(found.statistic), p, n)


def _exact(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    def product(a: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        return (a * b).sum(axis=axis)  # rises with the correlation, as the ranks stay the same

    found = stats.permutation_test((a,), product, permutation_type="pairings", vectorized=True, n_resamples=np.inf)
    return float(found.pvalue)


# --- the picture ---------------------------------------------------------------------------------------------------


def _limits(axes: Axes, dots: pd.DataFrame) -> None:
    """Around the dots: an interval of few runs may reach beyond, and an axis of its size would hide them."""
    distance = dots["distance"].to_numpy()
    if 0.0 < WIDE * distance.min() < distance.max():
        axes.set_xscale("log")
        axes.set_xlim(*np.exp(_around(np.log(distance))))
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_xlim(*_around(distance))
    axes.set_ylim(*_around(dots["performance"].to_numpy()))


def _around(values: NDArray[np.float64]) -> tuple[float, float]:
    margin = MARGIN * (float(np.ptp(values)) or 1.0)
    return float(values.min()) - margin, float(values.max()) + margin


def _marks(axes: Axes, table: pd.DataFrame, reference: str) -> list[Line2D]:
    means = table[(table["kind"] == "condition") & (table["n"] > 0)]
    dots = table[table["kind"] == "run"]
    names = list(means["condition"])
    seen = zip([color for color, _ in looks(names, reference)], _markers(names, reference), strict=True)
    marks = []
    for (_, mean), (color, marker) in zip(means.iterrows(), seen, strict=True):
        mine = dots[dots["condition"] == mean["condition"]]
        look: dict[str, Any] = {"color": color, "marker": marker, "linestyle": "none"}
        axes.plot(mine["distance"], mine["performance"], alpha=0.4, markersize=4, markeredgewidth=0, zorder=2, **look)
        marks.append(_mark(axes, mean, look, width=1.4 if len(names) <= MOST_LABELS else 0.6))
    return marks


def _markers(conditions: Sequence[str], reference: str) -> list[str]:
    """A marker for each condition, so that with its colour, one of seven, no two of the first 43 are alike."""
    others = itertools.cycle(MARKERS[1:])
    return [MARKERS[0] if name == reference else next(others) for name in conditions]


def _mark(axes: Axes, mean: pd.Series, look: Mapping[str, Any], width: float) -> Line2D:
    x, y = mean["distance"], mean["performance"]
    axes.errorbar(
        [x], [y], xerr=[mean["distance_half_width"]], yerr=[mean["performance_half_width"]], elinewidth=width,
        ecolor=look["color"], fmt="none", zorder=3,
    )  # fmt: skip
    return axes.plot(
        [x], [y], markersize=9, markeredgecolor="white", markeredgewidth=0.8, zorder=4, label=mean["condition"], **look
    )[0]


def _name(figure: Figure, axes: Axes, marks: Sequence[Line2D]) -> None:
    """Write the names beside the marks where all find room, else a legend."""
    figure.draw_without_rendering()
    radius = figure.dpi / 72 * 4.0  # of a mark, pixels
    taken = [Bbox.from_extents(*(place - radius), *(place + radius)) for place in map(_pixel, marks)]
    labels = [_label(axes, mark) for mark in marks[:MOST_LABELS]]
    if len(marks) > MOST_LABELS or not all(_place(axes, label, taken) for label in labels):
        for label in labels:
            label.remove()
        axes.legend(
            handles=marks, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8,
            ncols=-(-len(marks) // LEGEND_ROWS),
        )  # fmt: skip


def _pixel(mark: Line2D) -> NDArray[np.float64]:
    return mark.get_transform().transform(_where(mark))


def _where(mark: Line2D) -> tuple[float, float]:
    x, y = np.asarray(mark.get_xydata(), dtype=np.float64)[0]
    return float(x), float(y)


def _label(axes: Axes, mark: Line2D) -> Annotation:
    return axes.annotate(
        str(mark.get_label()), _where(mark), (0, 0), textcoords="offset points", color=mark.get_color(),
        fontsize=10, zorder=5, path_effects=[patheffects.withStroke(linewidth=3, foreground="white")],
    )  # fmt: skip


SIDES = ((5, 4, "left", "bottom"), (-5, 4, "right", "bottom"), (5, -5, "left", "top"), (-5, -5, "right", "top"))
"""Between the bars of a mark, where its name may stand: offsets in points, and how the text lies there."""


def _place(axes: Axes, label: Annotation, taken: list[Bbox]) -> bool:
    """Put a label on the first side of its mark where it covers nothing that is taken; False if there is none."""
    for x, y, horizontal, vertical in SIDES:
        label.set(position=(x, y), horizontalalignment=horizontal, verticalalignment=vertical)
        box = label.get_window_extent()
        if axes.bbox.containsx(box.x0) and axes.bbox.containsx(box.x1) and not box.count_overlaps(taken):
            taken.append(box)
            return True
    return False


def _title(table: pd.DataFrame) -> str:
    means = table[table["kind"] == "condition"]
    every = table[table["kind"] == "all"].iloc[0]
    bars = ", bars: 99 % confidence" if (means["n"] > 1).any() else ""
    parts = [f"dot: a run, {count(means['n'], 'run')} a condition; large mark: mean{bars}"]
    if excluded := int(every["excluded"]):
        parts.append(f"{count(excluded, 'run')} without a score left out")
    parts.append(_of_ranks(every, means))
    return "; ".join(parts)


def _of_ranks(every: pd.Series, means: pd.DataFrame) -> str:
    if np.isnan(every["spearman"]):
        return "too few different runs for a rank correlation"
    said = f"Spearman's rank correlation {_signed(every['spearman'])} over all {every['n']:,} runs ({_p(every['p'])})"
    within = means["spearman"].dropna()
    if len(means) < 2 or not len(within):
        return said
    return f"{said}, {_signed(within.min())} to {_signed(within.max())} within conditions"


def _signed(correlation: float) -> str:
    return f"{correlation:z.2f}".replace("-", "\u2212")


def _p(p: float) -> str:
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
