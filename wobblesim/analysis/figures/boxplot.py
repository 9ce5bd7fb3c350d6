"""Boxplots of the final performance, by the conventions of the paper (Benureau & Tani 2022, figure 3).

A box goes from the first to the third quartile, with a line at the median. Whiskers go to the least and the greatest
value, or to 1.5 times the height of the box from its edges, whichever is closer to the median; values beyond are
diamonds. Notches are the 99 % confidence interval of the median. Stars or brackets mark the conditions that differ from
the baseline by Wilcoxon's signed-rank test of runs with the same seed, at 0.01 after Holm's correction.
"""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from numpy.typing import ArrayLike, NDArray

from wobblesim.analysis.comparison import ALPHA, compare
from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import (
    FAINT,
    INK,
    OKABE_ITO,
    Drawing,
    count,
    dress,
    new_figure,
    performance_label,
)
from wobblesim.analysis.statistics import median_of
from wobblesim.analysis.tables import Results
from wobblesim.study.schema import PARAMETERS

WHISKER = 1.5
"""Longest whisker, in heights of the box."""

UNWOBBLED, FILLS = "0.82", (OKABE_ITO[1], OKABE_ITO[6], OKABE_ITO[3], OKABE_ITO[5], OKABE_ITO[7], OKABE_ITO[4])
"""Colours of boxes: of a condition without a wobble, and of the groups of the others."""

MOST_BRACKETS = 3
"""Conditions beside the baseline that have brackets; of more, a star above each box reads better."""

WAIST = 0.5
"""Width of a box at its median, if it has a notch, as a part of its width."""


# --- the numbers ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Box:
    """What a box shows of n values.

    Attributes
    ----------
    n : int
    q1, median, q3 : float
        Quartiles, interpolated linearly (Hyndman & Fan 1996, type 7).
    whisker_low, whisker_high : float
    median_low, median_high : float
        99 % confidence interval of the median, see `wobblesim.analysis.statistics.median_of`; NaN for few values.
    outliers : (n_outliers,)
        Values beyond the whiskers, in order.
    """

    n: int
    q1: float
    median: float
    q3: float
    whisker_low: float
    whisker_high: float
    median_low: float
    median_high: float
    outliers: NDArray[np.float64]


def box_of(values: ArrayLike) -> Box:
    """The box of values (n,); a NaN is left out, and without a value all is NaN."""
    values = np.sort(np.asarray(values, dtype=np.float64))
    values = values[np.isfinite(values)]
    if not len(values):
        return Box(0, *[np.nan] * 7, outliers=values)
    q1, median, q3 = (float(q) for q in np.quantile(values, [0.25, 0.5, 0.75]))
    low = max(float(values[0]), q1 - WHISKER * (q3 - q1))
    high = min(float(values[-1]), q3 + WHISKER * (q3 - q1))
    beyond = values[(values < low) | (values > high)]
    _, median_low, median_high, n = median_of(values)
    return Box(n, q1, median, q3, low, high, median_low, median_high, beyond)


# --- which boxes stand where -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Place:
    """Where the box of a condition stands.

    Parameters
    ----------
    condition : str
    x : float
        Middle of the box; ticks are one apart.
    width : float
    fill : str
        Colour.
    about : mapping
        Settings that the figure shows, for the table.
    """

    condition: str
    x: float
    width: float
    fill: str
    about: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Layout:
    """Boxes, and what stands at the axes.

    Parameters
    ----------
    places : sequence of Place
    ticks : mapping of float to str
        Labels below.
    label : str
        Of the x axis.
    groups : mapping of str to str
        Colour of each group of boxes, for the legend.
    """

    places: Sequence[Place]
    ticks: Mapping[float, str]
    label: str
    groups: Mapping[str, str] = field(default_factory=dict)


def grouped(settings: pd.DataFrame, x: str, label: str, hue: str) -> Layout:
    """Boxes by the value of a setting, side by side by that of another; those without a wobble stand at the left.

    Parameters
    ----------
    settings : DataFrame
        A row a condition, its index; NaN in `x` for one without a wobble.
    x : str
        Column whose values are ticks, in order.
    label : str
        Of the axis.
    hue : str
        Column whose values are colours, in the order in which they come.

    Raises
    ------
    FigureError
        If two conditions would stand at the same place.
    """
    still, wobbled = settings[settings[x].isna()], settings[settings[x].notna()]
    _refuse_doubles(wobbled, [x, hue], label.partition(" (")[0])
    values, hues = sorted(wobbled[x].unique()), list(dict.fromkeys(wobbled[hue]))
    fills = dict(zip(hues, itertools.cycle(FILLS), strict=False))
    n_ticks = len(still) + len(values)
    each = box_width(n_ticks, len(hues))
    places = [Place(str(name), float(n), box_width(n_ticks), UNWOBBLED) for n, name in enumerate(still.index)]
    for name, row in wobbled.iterrows():
        tick, shade = len(still) + values.index(row[x]), hues.index(row[hue])
        centre = tick + (shade - (len(hues) - 1) / 2) * each * GAP
        places.append(Place(str(name), centre, each, fills[row[hue]], {x: row[x], hue: row[hue]}))
    names = [*map(str, still.index), *(f"{value:g}" for value in values)]
    ticks = {float(n): name for n, name in enumerate(names)}
    return Layout(places, ticks, label if len(hues) > 1 else f"{label}, {hues[0]}", fills)


def _refuse_doubles(wobbled: pd.DataFrame, place: list[str], what: str) -> None:
    """Refuse conditions that would stand at one place."""
    for _, alike in wobbled.groupby(place):
        if len(alike) > 1:
            raise FigureError(
                f"{alike.index[0]} and {alike.index[1]} have the same {what} and would be one box; choose conditions "
                "with --condition, or draw `boxes`"
            )


def box_width(ticks: int, boxes: int = 1) -> float:
    """Width of each of the boxes beside one another at a tick: a part of the room, and of the page if they are few."""
    return min(0.66, WIDEST * ticks, 0.8 / (boxes * GAP))


WIDEST, GAP = 0.09, 1.2
"""Width of a box, at most, as a part of that of the axes; and from box to box at a tick, in widths."""


def settings_of(results: Results, choice: Choice) -> pd.DataFrame:
    """The settings of the conditions shown, the baseline among them: a row a condition, its index."""
    names = {*choice.shown(results), choice.reference(results)}
    found = results.runs("condition", *(name for name in PARAMETERS if name != "log"))
    found = found[found["condition"].isin(names)].groupby("condition", observed=True).first()
    found.index = found.index.astype(str)
    return found


def require_varied(settings: pd.DataFrame, shown: str) -> None:
    """Refuse a study in which the setting that a figure shows, a column of `settings_of`, does not vary.

    Raises
    ------
    FigureError
    """
    if settings[shown].nunique() < LEAST_VALUES:
        raise FigureError(f"{shown} does not vary among the conditions shown; draw `boxes` for them as they are")


def require_alone(settings: pd.DataFrame, shown: str, along: Sequence[str] = ()) -> None:
    """Refuse a study in which another setting varies than the one shown and those that may vary along with it.

    Settings of the wobble are compared among the conditions that have one.

    Raises
    ------
    FigureError
    """
    wobbled = settings[settings[shown].notna()]
    others = [
        str(name)
        for name in settings
        if name not in {shown, *along}
        and (wobbled if str(name).startswith("wobble.") else settings)[name].nunique(dropna=False) > 1
    ]
    if others:
        raise FigureError(
            f"{' and '.join(others)} {'varies' if len(others) == 1 else 'vary'} beside {shown}; choose conditions that "
            "share the rest with --condition, or draw `boxes`"
        )


LEAST_VALUES = 2


# --- the picture -----------------------------------------------------------------------------------------------------


def box_figure(results: Results, choice: Choice, layout: Layout, width: float) -> Drawing:
    """Draw the boxes of a layout, the baseline among them, what differs from it, and a dashed line at its median.

    The table has a row a box: ``condition``; the settings shown; ``n`` runs and how many are ``excluded``, whose trials
    of the last epoch all diverged; the numbers of `Box` in body lengths, the ``outliers`` joined by semicolons;
    ``p_wilcoxon`` and ``p_holm`` of the comparison with the baseline, NaN for itself.
    """
    reference = choice.reference(results)
    names = [place.condition for place in layout.places]
    scores = _scores(results, names)
    boxes = {name: box_of(values) for name, values in scores.items()}
    pairs = compare(results, reference, conditions=names).pairs.set_index("condition")
    figure = new_figure(width, HEIGHT + _below(layout, width))
    axes = figure.add_subplot()
    for place in layout.places:
        _draw(axes, place, boxes[place.condition])
    _note_excluded(axes, layout.places, scores)
    _name_places(axes, layout, width)
    dress(axes, layout.label, f"final performance\n({performance_label(results)})")
    said = _says(boxes, scores, pairs, reference, width)
    figure.suptitle(said, x=0.01, ha="left", fontsize=9, color="0.3")
    _mark(axes, layout.places, boxes, pairs["significant"], reference)
    if len(layout.groups) > 1:
        handles = [Patch(facecolor=color, edgecolor=INK, label=name) for name, color in layout.groups.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    return Drawing(figure, _table(layout.places, boxes, scores, pairs))


def _scores(results: Results, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Final performance of the runs of conditions."""
    runs = results.runs("condition", "performance")
    return {name: runs.loc[runs["condition"] == name, "performance"].to_numpy() for name in names}


def _draw(axes: Axes, place: Place, box: Box) -> None:
    """Draw a box; where its notch would be taller than itself, a bar in its middle shows the interval instead."""
    if not box.n:
        return
    notched = _notched(box)
    numbers = {
        "q1": box.q1, "med": box.median, "q3": box.q3, "whislo": box.whisker_low, "whishi": box.whisker_high,
        "fliers": box.outliers, "cilo": box.median_low, "cihi": box.median_high,
    }  # fmt: skip
    line = {"color": INK, "linewidth": 0.9}
    axes.bxp(
        [numbers], positions=[place.x], widths=place.width, capwidths=place.width * WAIST, patch_artist=True,
        shownotches=notched, manage_ticks=False, boxprops={"facecolor": place.fill, "edgecolor": INK, "linewidth": 0.9},
        medianprops={"color": INK, "linewidth": 1.8}, whiskerprops=line, capprops=line,
        flierprops={"marker": "d", "markersize": 4, "markerfacecolor": "none", "markeredgecolor": INK,
                    "markeredgewidth": 0.8},
    )  # fmt: skip
    if not notched and np.isfinite(box.median_low):
        bar, height = place.width * BAR, box.median_high - box.median_low
        look = {"facecolor": INK, "alpha": 0.45, "linewidth": 0.0, "zorder": 2.5}
        axes.add_patch(Rectangle((place.x - bar / 2, box.median_low), bar, height, **look))


def _notched(box: Box) -> bool:
    """Whether the interval of the median is known and lies within the box."""
    return bool(box.q1 <= box.median_low and box.median_high <= box.q3)


BAR = 0.16
"""Width of the bar that shows an interval taller than the box, as a part of the box's."""


def _top(box: Box) -> float:
    """The highest mark of a box."""
    return max([box.whisker_high, box.median_high if np.isfinite(box.median_high) else -np.inf, *box.outliers])


def _mark(
    axes: Axes, places: Sequence[Place], boxes: Mapping[str, Box], significant: pd.Series, reference: str
) -> None:
    """Mark the baseline's median, and what differs from it: by brackets if few are compared, else by stars."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.04 * (high - low))  # room for stars
    axes.set_xlim(min(place.x for place in places) - 0.6, max(place.x for place in places) + 0.6)
    if not boxes[reference].n or len(places) == 1:
        return
    axes.axhline(boxes[reference].median, color=FAINT, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
    marked = [place for place in places if significant.get(place.condition, False)]
    if len(significant) <= MOST_BRACKETS:
        base = next(place.x for place in places if place.condition == reference)
        _brackets(axes, base, [place.x for place in marked], max(_top(box) for box in boxes.values() if box.n))
        return
    for place in marked:
        _star(axes, place.x, _top(boxes[place.condition]))


def _star(axes: Axes, x: float, y: float, rise: float = 0.0) -> None:
    axes.annotate(
        "*", (x, y), (0, rise), textcoords="offset points", ha="center", va="bottom", fontsize=12, color=INK,
        annotation_clip=False,
    )  # fmt: skip


def _brackets(axes: Axes, base: float, marked: Sequence[float], top: float) -> None:
    """Brackets from the baseline's place, one above the other, the shortest at the bottom."""
    low, high = axes.get_ylim()
    step = 0.09 * (high - low)
    for level, x in enumerate(sorted(marked, key=lambda x: abs(x - base))):
        y = top + (level + 0.5) * step
        foot = y - 0.2 * step
        axes.plot([base, base, x, x], [foot, y, y, foot], color=INK, linewidth=0.9, label="bracket")
        _star(axes, (base + x) / 2, y, rise=-2)
    axes.set_ylim(low, max(high, top + (len(marked) + 0.5) * step))


def _note_excluded(axes: Axes, places: Sequence[Place], scores: Mapping[str, NDArray[np.float64]]) -> None:
    for place in places:
        if lost := int(np.isnan(scores[place.condition]).sum()):
            axes.annotate(
                f"×{lost}", (place.x, 0), (0, 2), xycoords=("data", "axes fraction"), textcoords="offset points",
                ha="center", va="bottom", fontsize=8, color=LOST,
            )  # fmt: skip


LOST = OKABE_ITO[4]
"""Colour of what says that runs have no score."""


def _name_places(axes: Axes, layout: Layout, width: float) -> None:
    """Write the labels of the ticks, turned where they would run into each other."""
    axes.set_xticks(list(layout.ticks), list(layout.ticks.values()))
    axes.tick_params(axis="x", length=0)
    if _turned(layout, width):
        for label in axes.get_xticklabels():
            label.set(rotation=TURN, ha="right", rotation_mode="anchor", fontsize=9)


def _turned(layout: Layout, width: float) -> bool:
    """Whether labels are too long for the room that each of them has."""
    return _longest(layout) > 0.85 * width / len(layout.ticks)


def _below(layout: Layout, width: float) -> float:
    """Inches that turned labels need below the axes, beyond a line of text."""
    return max(0.0, _longest(layout) * math.sin(math.radians(TURN)) - 0.5) if _turned(layout, width) else 0.0


def _longest(layout: Layout) -> float:
    """Length of the longest label, inches."""
    return LETTER * max(map(len, layout.ticks.values()))


HEIGHT, LETTER, TURN = 4.8, 0.08, 50
"""Height of a figure and width of a letter of a label, inches; and degrees by which long labels are turned."""


def _says(
    boxes: Mapping[str, Box],
    scores: Mapping[str, NDArray[np.float64]],
    pairs: pd.DataFrame,
    reference: str,
    width: float,
) -> str:
    """What the marks mean, those that are there, in lines that fit into a figure so wide."""
    runs = [len(values) for values in scores.values()]
    parts = [f"{count(runs, 'run')} a condition", *_on_intervals(boxes.values())]
    if any(np.isnan(values).any() for values in scores.values()):
        parts.append("×: runs without a score, left out")
    if not len(pairs):
        return textwrap.fill(", ".join(parts), int(width * LETTERS))
    if boxes[reference].n:
        parts.append(f"dashed: median of {reference}")
    return "\n".join(
        textwrap.fill(line, int(width * LETTERS)) for line in (", ".join(parts), _on_tests(pairs, reference))
    )


LETTERS = 13
"""Letters of a title that fit into an inch."""


def _on_intervals(boxes: Iterable[Box]) -> list[str]:
    """How the intervals of the medians are shown."""
    known = [box for box in boxes if np.isfinite(box.median_low)]
    if not known:
        return ["too few for confidence of the median"]
    tall = sum(not _notched(box) for box in known)
    said = []
    if tall < len(known):
        said.append("notch: 99 % confidence of the median")
    if tall:
        said.append(f"dark bar: {'the same, beyond the box' if said else '99 % confidence of the median'}")
    return said


def _on_tests(pairs: pd.DataFrame, reference: str) -> str:
    """What the stars mean, or why there is none."""
    test = f"{reference} (Wilcoxon's signed-rank test, p < {ALPHA:g} after Holm's correction)"
    if pairs["significant"].any():
        return f"*: differs from {test}"
    # The least p is that of differences of one sign, in the correction times the tests.
    if not (2.0 ** (1 - pairs["n_pairs"]) * len(pairs) < ALPHA).any():
        return f"too few pairs to tell any from {test}"
    return f"none differs from {test}"


def _table(
    places: Sequence[Place], boxes: Mapping[str, Box], scores: Mapping[str, NDArray[np.float64]], pairs: pd.DataFrame
) -> pd.DataFrame:
    return pd.DataFrame([_row(place, boxes[place.condition], scores[place.condition], pairs) for place in places])


def _row(place: Place, box: Box, scores: NDArray[np.float64], pairs: pd.DataFrame) -> dict[str, object]:
    tested = pairs.loc[place.condition] if place.condition in pairs.index else {"p": np.nan, "p_holm": np.nan}
    return {
        "condition": place.condition,
        **place.about,
        "n": box.n,
        "excluded": len(scores) - box.n,
        "q1": box.q1,
        "median": box.median,
        "q3": box.q3,
        "whisker_low": box.whisker_low,
        "whisker_high": box.whisker_high,
        "median_low": box.median_low,
        "median_high": box.median_high,
        "n_outliers": len(box.outliers),
        "outliers": ";".join(repr(float(value)) for value in box.outliers),
        "p_wilcoxon": float(tested["p"]),
        "p_holm": float(tested["p_holm"]),
    }
