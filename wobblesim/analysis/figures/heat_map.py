"""Final performance over the period and the amplitude of the wobble, as a map."""

from __future__ import annotations

import math
import textwrap
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import offset_copy
from numpy.typing import ArrayLike

from wobblesim.analysis.comparison import ALPHA, compare
from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import (
    DIVERGING,
    SEQUENTIAL,
    WIDTH,
    Drawing,
    count,
    new_figure,
    performance_label,
)
from wobblesim.analysis.tables import Results
from wobblesim.study.schema import PARAMETERS

PLACE = ("wobble.period", "wobble.amplitude")
FORM = ("wobble.dimension", "wobble.mean", "wobble.upper_bound")

SIDE_BY_SIDE = 3
"""Panels in a row, at most."""

CELL_WIDTH, CELL_HEIGHT = 0.42, 0.42
"""Inches: what a number needs, and the height of a cell."""

LETTERS = 14
"""Of a title that fit into an inch."""


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw a cell for each period and amplitude, in a panel for each dimension and form of the wobble.

    Where there is a condition ``fixed``, or a baseline is chosen, a cell is the mean difference from it, paired by
    seed, and a star is a difference that is significant: p < 0.01 by Wilcoxon's test after Holm's correction over the
    conditions shown (see `compare`). Else it is the mean performance. A hatched cell has no score: no condition, or all
    of its runs are excluded.

    The table has a row for each cell: ``panel``, ``amplitude``, ``period``, ``condition`` (empty if there is none), its
    ``runs`` and how many are ``excluded``, ``mean`` of the performance in body lengths; ``baseline``, ``difference``
    from it with its ``difference_half_width`` (99 % confidence), ``n_pairs``, ``p_holm`` and ``significant``, without
    value where there is no baseline; ``shown``, the number of the colour.

    Raises
    ------
    FigureError
        If the wobbles that are shown do not differ in both period and amplitude, or two of them have one cell.
    """
    table = check(results, choice)
    return Drawing(_picture(table, performance_label(results)), table)


def check(results: Results, choice: Choice) -> pd.DataFrame:
    """The table of `draw`, or its error."""
    runs = results.runs("condition", "seed", "performance", *PARAMETERS)
    runs = runs[runs["condition"].isin(choice.shown(results)) & runs["wobble.dimension"].notna()]
    runs = runs.astype({"condition": str})
    cells = _cells(runs.drop_duplicates("condition").set_index("condition"))
    scores = runs.groupby("condition")["performance"].agg(runs="size", scored="count", mean="mean")
    table = _filled(cells).join(scores, on="condition").join(_differences(results, choice, cells), on="condition")
    table = table.fillna({"condition": "", "runs": 0, "scored": 0, "n_pairs": 0, "baseline": "", "significant": False})
    table.insert(4, "excluded", table["runs"] - table.pop("scored"))
    table["shown"] = table["difference"] if table["baseline"].any() else table["mean"]
    return table.astype({"runs": "int64", "excluded": "int64", "n_pairs": "int64", "significant": "bool"})


# --- the cells -----------------------------------------------------------------------------------------------------


def _cells(settings: pd.DataFrame) -> pd.DataFrame:
    """Panel, amplitude and period of each condition, whose settings are given by condition."""
    cells = pd.DataFrame(
        {
            "panel": _panels(settings),
            "amplitude": settings["wobble.amplitude"],
            "period": settings["wobble.period"],
            "condition": settings.index,
        }
    )
    sizes = cells.groupby("panel", sort=False)[["amplitude", "period"]].nunique()
    if not (sizes >= 2).all(axis="columns").any():
        raise FigureError(
            "the wobbles shown do not differ in both their period and their amplitude; sweep wobble.period and "
            "wobble.amplitude, or draw their boxes"
        )
    for _, alike in cells.groupby(["panel", "amplitude", "period"], sort=False):
        if len(alike) > 1:
            raise FigureError(f"{' and '.join(alike['condition'])} have the same wobble; choose one of them to show")
    return cells.reset_index(drop=True)


def _panels(settings: pd.DataFrame) -> pd.Series:
    """In words, what sets the conditions apart besides period and amplitude: one panel each."""
    varying = [name for name in PARAMETERS if settings[name].nunique(dropna=False) > 1]
    others = [name for name in varying if name not in (*PLACE, *FORM, "log")]
    return settings.apply(
        lambda row: ", ".join([_form(row), *(f"{name} {_word(row[name])}" for name in others)]), axis=1
    )


def _form(wobble: pd.Series) -> str:
    dimension, mean, bound, amplitude = (wobble[name] for name in (*FORM, "wobble.amplitude"))
    parts = [" and ".join(str(dimension).split("+"))]
    if math.isclose(mean + amplitude, 1.0):
        parts.append("mean 1 \u2212 amplitude")
    elif mean != 1.0:
        parts.append(f"mean {mean:g}")
    if not pd.isna(bound):
        parts.append(f"at most {bound:g}")
    return ", ".join(parts)


def _word(value: Any) -> str:
    if pd.isna(value):
        return "none"
    return value if isinstance(value, str) else f"{value:g}"


def _filled(cells: pd.DataFrame) -> pd.DataFrame:
    """All cells of each panel, also those without a condition, by amplitude and period."""
    place = ["panel", "amplitude", "period"]
    every = [
        pd.MultiIndex.from_product([[panel], sorted(set(mine["amplitude"])), sorted(set(mine["period"]))], names=place)
        for panel, mine in cells.groupby("panel", sort=False)
    ]
    return pd.concat([index.to_frame(index=False) for index in every]).merge(cells, how="left", on=place)


def _differences(results: Results, choice: Choice, cells: pd.DataFrame) -> pd.DataFrame:
    """Differences from the baseline by condition; without a value if there is none."""
    columns = ["difference", "difference_half_width", "n_pairs", "p_holm", "significant"]
    conditions = cells["condition"].tolist()
    if choice.baseline is None and "fixed" not in results.conditions:
        return pd.DataFrame(columns=["baseline", *columns], index=conditions)
    reference = choice.reference(results)
    pairs = compare(results, reference, conditions=conditions).pairs.set_index("condition")[columns]
    found = pairs.reindex(conditions)
    if reference in conditions:
        found.loc[reference, "difference"] = 0.0
    found.insert(0, "baseline", reference)
    return found


# --- the picture ---------------------------------------------------------------------------------------------------


def _picture(table: pd.DataFrame, unit: str) -> Figure:
    panels = {str(panel): mine for panel, mine in table.groupby("panel", sort=False)}
    columns = 2 if len(panels) == 4 else min(len(panels), SIDE_BY_SIDE)
    wide, high = (int(table.groupby("panel")[name].nunique().max()) for name in ("period", "amplitude"))
    rows = -(-len(panels) // columns)
    width = float(np.clip(columns * (0.75 * wide + 0.7) + 1.3, 5.0, WIDTH))
    figure = new_figure(width, 0.7 + rows * (max(CELL_HEIGHT * high, 1.6) + 0.9))
    grid = figure.subplots(rows, columns, squeeze=False)
    reference = str(table["baseline"].iloc[0])
    colors = _colors(table["shown"], diverging=bool(reference))
    room = ((width - 1.3) / columns - 0.7) / wide
    for axes, (panel, cells) in zip(grid.flat, panels.items(), strict=False):
        _panel(axes, cells, colors, numbers=room >= CELL_WIDTH)
        axes.set_title(panel, loc="left", fontsize=9)
    for unused in grid.flat[len(panels) :]:
        unused.remove()
    said = f"difference from {reference}" if reference else "mean performance"
    figure.colorbar(colors, ax=list(grid.flat[: len(panels)]), label=f"{said}\n({unit})", fraction=0.05)
    title = textwrap.fill(_title(table), round(LETTERS * width))
    figure.suptitle(title, x=0.01, ha="left", fontsize=9, color="0.3")
    return figure


def _colors(shown: pd.Series, diverging: bool) -> ScalarMappable:
    known = shown.dropna()
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    if diverging:
        low, high = -max(-low, high), max(-low, high)
    if low == high:
        low, high = low - 1.0, high + 1.0
    return ScalarMappable(Normalize(low, high), DIVERGING if diverging else SEQUENTIAL)


def _panel(axes: Axes, cells: pd.DataFrame, colors: ScalarMappable, numbers: bool) -> None:
    periods, amplitudes = (sorted(set(cells[name])) for name in ("period", "amplitude"))
    decimals = _decimals(colors)
    for _, cell in cells.iterrows():
        place = periods.index(cell["period"]), amplitudes.index(cell["amplitude"])
        _cell(axes, place, cell, colors, f"{{:{'+' if cell['baseline'] else ''}z.{decimals}f}}" if numbers else "")
    axes.set_xlim(-0.5, len(periods) - 0.5)
    axes.set_ylim(-0.5, len(amplitudes) - 0.5)
    axes.set_xticks(range(len(periods)), [f"{period:g}" for period in periods])
    axes.set_yticks(range(len(amplitudes)), [f"{amplitude:g}" for amplitude in amplitudes])
    axes.set_xlabel("period (epochs)")
    axes.set_ylabel("amplitude (factor)")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _cell(axes: Axes, place: tuple[int, int], cell: pd.Series, colors: ScalarMappable, number: str) -> None:
    x, y = place
    corner = (x - 0.5, y - 0.5)
    if math.isnan(cell["shown"]):
        axes.add_patch(Rectangle(corner, 1, 1, facecolor="0.93", edgecolor="0.6", hatch="////", linewidth=0))
        return
    color = colors.to_rgba(cell["shown"])
    axes.add_patch(Rectangle(corner, 1, 1, facecolor=color, edgecolor="white", linewidth=1))
    ink = ink_on(color)
    if number:
        axes.annotate(
            number.format(cell["shown"]).replace("-", "\u2212"), place, (0, 4), textcoords="offset points",
            ha="center", va="center", color=ink, fontsize=8,
        )  # fmt: skip
    if cell["significant"]:
        below = offset_copy(axes.transData, axes.get_figure(root=True), y=-7 if number else 0, units="points")
        axes.plot([x], [y], marker="*", markersize=7, color=ink, markeredgewidth=0, transform=below)


def _decimals(colors: ScalarMappable) -> int:
    """Decimals that show the largest number with two digits."""
    largest = float(np.abs(colors.get_clim()).max())
    return int(np.clip(1 - math.floor(math.log10(largest)), 0, 4))


def ink_on(color: ArrayLike) -> str:
    """Black or white, whichever has the greater contrast on a colour (WCAG 2.2, relative luminance)."""
    parts = np.asarray(color, dtype=np.float64)[:3]
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    luminance = float(linear @ (0.2126, 0.7152, 0.0722))
    return "black" if (luminance + 0.05) ** 2 > 0.05 * 1.05 else "white"


def _title(table: pd.DataFrame) -> str:
    there = table[table["runs"] > 0]
    reference = str(table["baseline"].iloc[0])
    parts = [f"mean of {count(there['runs'], 'run')} a cell"]
    if reference:
        family = int(there["p_holm"].notna().sum())
        pairs = there.loc[there["condition"] != reference, "n_pairs"]
        mark = "star:" if there["significant"].any() else "no cell has"
        parts = [
            f"mean difference from {reference} of {count(pairs, 'pair')} a cell",
            f"{mark} p < {ALPHA:g} (Wilcoxon, Holm over {count(family, 'condition')})",
        ]
    if excluded := int(there["excluded"].sum()):
        parts.append(f"{count(excluded, 'run')} without a score left out")
    if table["shown"].isna().any():
        parts.append("hatched: no score")
    return "; ".join(parts)
