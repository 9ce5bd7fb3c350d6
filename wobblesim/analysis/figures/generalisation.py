"""The learnt gait on the whole range of the wobbled dimension: what it is worth on lighter or heavier robots."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import (
    MOST_LABELS,
    WIDTH,
    Drawing,
    band,
    count,
    dress,
    looks,
    mark_epoch,
    name_curves,
    new_figure,
    performance_label,
)
from wobblesim.analysis.generalise import generalise, last_behaviours, span_of, spans
from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import Results

MOST_RUNS = 32
"""Runs of a condition that are tried, those of the least seeds: the paper's figure 3A takes some 40 s of a core."""

MOST_BANDS = 5
"""Curves of a panel that have a band; more of them would be one grey."""

LETTERS = 14
"""Of a title that fit into an inch."""


def draw(results: Results, choice: Choice) -> Drawing:
    """Try the last best behaviours on other robots, and draw the mean performance of each condition with its 99 % band.

    There is a panel for each dimension that wobbles in the study, alone or with others. A fixed robot is in all of
    them. Trials that diverge are left out of a mean, and the point has a cross. A curve is thick over the factors that
    the robot met while it learned. At most `MOST_RUNS` runs of a condition are tried; see `generalise` for all.

    The table has a row for each point: ``dimension``, ``condition``, ``factor`` on the adult's value, ``mean``, ``low``
    and ``high`` (99 % confidence) of the performance in body lengths, ``n``, the runs with a score there, how many
    ``diverged``, and ``repeated``: of the trials that the results have too, that is those on the robot of the last
    epoch, how many came out again bit for bit, and how many were ``stored``.

    Raises
    ------
    FigureError
        If nothing that is shown wobbles, or the results are of a version that kept no last behaviour.
    """
    runs = check(results, choice)
    tried = generalise(results, choice.shown(results), most=MOST_RUNS)
    table = points(tried)
    figure = _picture(table, runs, choice.reference(results), performance_label(results))
    figure.suptitle(_title(table, tried, runs), x=0.01, ha="left", fontsize=9, color="0.3")
    return Drawing(figure, table)


def check(results: Results, choice: Choice) -> pd.DataFrame:
    """The runs shown; an error as of `draw` if they are not enough for it."""
    every = last_behaviours(results)
    wobbled = every["wobble.dimension"].isin(spans(every)) | every["wobble.dimension"].isna()
    runs = every[every["condition"].isin(choice.shown(results)) & wobbled]
    if runs["performance"].isna().all():
        raise FigureError(
            "no run that is shown has a score, so that there is no learnt gait to try; choose conditions that have one"
        )
    return runs


def points(tried: pd.DataFrame) -> pd.DataFrame:
    """A row a dimension, condition and factor of what `generalise` found; columns as in the table of `draw`."""
    keys = ["dimension", "condition", "factor"]
    groups = tried.groupby(keys, observed=True, sort=False)
    return pd.DataFrame([dict(zip(keys, key, strict=True)) | _point(mine) for key, mine in groups])


def _point(tried: pd.DataFrame) -> dict[str, float]:
    found = mean_of(tried["performance"])
    return {
        "mean": float(found.mean),
        "low": float(found.low),
        "high": float(found.high),
        "n": int(found.n),
        "diverged": int((tried["status"] == "diverged").sum()),
        "stored": int(tried["stored"].notna().sum()),
        "repeated": int((tried["stored"] == tried["performance"]).sum()),
    }


# --- the picture ---------------------------------------------------------------------------------------------------


def _picture(table: pd.DataFrame, runs: pd.DataFrame, reference: str, unit: str) -> Figure:
    """A panel a dimension, one below the other: their curves are named at the right."""
    dimensions = list(dict.fromkeys(table["dimension"]))
    conditions = list(dict.fromkeys(table["condition"]))
    seen = dict(zip(conditions, looks(conditions, reference), strict=True))
    figure = new_figure(height=1.0 + (3.8 if len(dimensions) == 1 else 3.0 * len(dimensions)))
    axes = figure.subplots(len(dimensions), 1, squeeze=False)[:, 0]
    for panel, dimension in zip(axes, dimensions, strict=True):
        _panel(panel, table[table["dimension"] == dimension], runs, seen)
        of = " and ".join(dimension.split("+"))
        dress(panel, f"factor on the adult's {of}", f"performance of the learnt gait\n({unit})", grid="both")
    return figure


def _panel(axes: Axes, table: pd.DataFrame, runs: pd.DataFrame, seen: Mapping[str, tuple[str, str]]) -> None:
    curves = {str(name): mine for name, mine in table.groupby("condition", observed=True, sort=False)}
    met = {str(name): span_of(mine.iloc[0]) for name, mine in runs.groupby("condition", observed=True)}
    lines = [_curve(axes, name, mine, met[name], seen[name], len(curves)) for name, mine in curves.items()]
    axes.set_xlim(table["factor"].min(), table["factor"].max())
    mark_epoch(axes, 1.0, "adult")
    name_curves(axes, lines)


def _curve(
    axes: Axes, name: str, points: pd.DataFrame, met: tuple[float, float], seen: tuple[str, str], of: int
) -> Line2D:
    """A thin line, one of so many, that is thick where the robot has been while it learned."""
    (color, dash), factor, mean = seen, points["factor"].to_numpy(), points["mean"].to_numpy()
    if of <= MOST_BANDS:
        band(axes, factor, points["low"], points["high"], color)
    lost = points[points["diverged"] > 0]
    axes.plot(lost["factor"], lost["mean"], marker="x", markersize=6, color=color, linestyle="none")
    thick = 2.6 if of <= MOST_LABELS else 1.6
    been = np.unique(np.clip([*met, *factor], *met))
    marker = "o" if len(been) == 1 else None
    axes.plot(been, np.interp(been, factor, mean), color=color, linestyle=dash, linewidth=thick, marker=marker)
    return axes.plot(factor, mean, color=color, linestyle=dash, linewidth=thick / 3, label=name)[0]


def _title(table: pd.DataFrame, tried: pd.DataFrame, runs: pd.DataFrame) -> str:
    scored = runs[runs["performance"].notna()].groupby("condition", observed=True).size()
    used = tried.groupby("condition", observed=True)["seed"].nunique()
    first = f", the first of {scored.max():,}" if scored.max() > used.max() else ""
    bands = ", band: 99 % confidence" if _most_curves(table) <= MOST_BANDS and used.max() > 1 else ""
    parts = [f"mean of {count(used, 'run')} a condition{first}{bands}; thick, dot: factors met while learning"]
    if lost := int(table["diverged"].sum()):
        parts.append(f"cross: {lost:,} of {len(tried):,} trials diverged and are left out")
    if unscored := int(runs["performance"].isna().sum()):
        parts.append(f"{count(unscored, 'run')} without a score left out")
    if changed := int((table["stored"] - table["repeated"]).sum()):
        parts.append(
            f"{changed:,} of {table['stored'].sum():,} stored trials come out otherwise: other version or processor"
        )
    return textwrap.fill("; ".join(parts), round(LETTERS * WIDTH))


def _most_curves(table: pd.DataFrame) -> int:
    return int(table.groupby("dimension")["condition"].nunique().max())
