"""How all figures look: colours, sizes, and how a figure becomes files."""

from __future__ import annotations

import io
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from wobblesim.analysis.tables import Results

OKABE_ITO = ("#000000", "#E69F00", "#0072B2", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442")
"""Colours that people with any colour vision tell apart (Okabe & Ito 2008); the pale yellow last."""

DASHES = ("-", "--", "-.", ":")
INK, FAINT, GRID = "0.2", "0.45", "0.9"
"""Greys of text, of marks that explain, and of the grid."""

SEQUENTIAL, DIVERGING = "cividis", "PuOr"
"""Colour maps that keep their order for people with any colour vision."""

WIDTH, WIDE = 8.0, 11.0
"""Of a figure, and of one with a legend beside it, inches."""

FORMATS = ("png", "svg", "pdf")
RESOLUTION, DOTS = 150, 300
"""Of a PNG, and of what is dots also in SVG and PDF, such as a cloud of 80,000 trials; dots an inch."""

MOST_LABELS = 10
"""Curves that are named at their ends and have bands; more of them have a legend, and bands would hide them all."""

LINE_OF_TEXT = 13.0
"""Height of a label and its gap to the next, points."""

ABOVE_WORDS = 16.0
"""Of a title above axes that have words at their upper edge (`mark_epoch`), points."""

MOST_COLUMNS, LEGEND_ROWS = 4, 26
"""Panels side by side, and entries of a legend one below the other, at most."""

# The same figure is the same bytes: no date, and ids in the SVG that are counted instead of drawn by lot.
_METADATA: Mapping[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
_SETTINGS: dict[Any, Any] = {"svg.hashsalt": "wobblesim", "svg.fonttype": "none", "pdf.fonttype": 42}


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure and the numbers in it.

    Attributes
    ----------
    figure : Figure
        Of matplotlib; no part of its global state.
    table : DataFrame
        What is drawn: a row for each mark or point, the units in the names of the columns or in its docstring.
    """

    figure: Figure
    table: pd.DataFrame

    def _repr_png_(self) -> bytes:
        """How a notebook shows it."""
        return as_bytes(self.figure, "png")


def new_figure(width: float = WIDTH, height: float = 4.8) -> Figure:
    """An empty figure of a size in inches, which lays out itself."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def looks(conditions: Sequence[str], reference: str) -> list[tuple[str, str]]:
    """Colour and dashes of each condition: the baseline's black is no other's, and no two of the first 29 are alike."""
    colors = OKABE_ITO[1:]
    others = (look for dash in itertools.cycle(DASHES) for look in zip(colors, itertools.repeat(dash), strict=False))
    return [(OKABE_ITO[0], DASHES[0]) if name == reference else next(others) for name in conditions]


def dress(axes: Axes, x: str, y: str, title: str = "", grid: str = "y", pad: float = 10.0) -> None:
    """Name axes with their units, say in grey what is seen, and take away what says nothing."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title, loc="left", fontsize=9, color="0.3", pad=pad)
    axes.spines[["top", "right"]].set_visible(False)
    if grid:
        axes.grid(axis=grid, color=GRID, linewidth=0.8)  # type: ignore[arg-type]
    axes.set_axisbelow(True)


def as_bytes(figure: Figure, form: str) -> bytes:
    """A figure as a file of one of `FORMATS`; the same bytes for the same figure."""
    content = io.BytesIO()
    with mpl.rc_context(_SETTINGS):
        figure.savefig(content, format=form, dpi=RESOLUTION if form == "png" else DOTS, metadata=_METADATA[form])
    return content.getvalue()


def files_of(drawing: Drawing, name: str, formats: Sequence[str] = FORMATS) -> dict[str, bytes]:
    """The files of a drawing by name: its pictures, and its table as CSV."""
    made = {f"{name}.{form}": as_bytes(drawing.figure, form) for form in formats}
    return made | {f"{name}.csv": drawing.table.to_csv(index=False, lineterminator="\n").encode()}


# --- what several figures have -------------------------------------------------------------------------------------


def performance_label(results: Results) -> str:
    """The unit of a performance: ``body lengths in 60 s``, if all trials of the study last alike."""
    durations = results.runs("trial.duration")["trial.duration"].unique()
    return f"body lengths in {durations[0]:g} s" if len(durations) == 1 else "body lengths in a trial"


def panels(figure: Figure, count: int, **options: Any) -> list[Axes]:
    """Panels side by side, at most four in a row, that share their axes; those without use are not there."""
    columns = min(count, MOST_COLUMNS)
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, **options)
    for unused in grid.flat[count:]:
        unused.remove()
    return list(grid.flat[:count])


def over_epochs(axes: Axes, last: float) -> None:
    """Let the x axis go from epoch 0 to the last, with whole numbers at its ticks."""
    axes.set_xlim(-0.5, last + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator("auto", integer=True, steps=[1, 2, 5, 10]))


def curves_figure(curves: int) -> Figure:
    """An empty figure for so many curves, with room for a legend if they are many."""
    return new_figure(WIDTH if curves <= MOST_LABELS else WIDE)


def name_curves(axes: Axes, lines: Sequence[Line2D]) -> None:
    """Write the label of each line at its end, or a legend if they are many. The limits of the axes stand."""
    if len(lines) > MOST_LABELS:
        axes.legend(
            handles=lines, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8, handlelength=3,
            ncols=-(-len(lines) // LEGEND_ROWS),
        )  # fmt: skip
        return
    gap = LINE_OF_TEXT / 72 / (axes.get_position().height * axes.figure.get_figure(root=True).get_figheight())
    heights = spread([_end_of(axes, line) for line in lines], gap)
    for line, height in zip(lines, heights, strict=True):
        axes.annotate(
            str(line.get_label()), (1.0, height), (6, 0), xycoords="axes fraction", textcoords="offset points",
            ha="left", va="center", color=line.get_color(), fontsize=10,
        )  # fmt: skip


def _end_of(axes: Axes, line: Line2D) -> float:
    """Where a line ends, as a fraction of the height of the axes; at the lower edge if it is nowhere."""
    heights = np.asarray(line.get_ydata(), dtype=np.float64)
    known = heights[np.isfinite(heights) & ((heights > 0.0) | (axes.get_yscale() != "log"))]
    if not len(known):
        return 0.0
    place = axes.transAxes.inverted().transform(axes.transData.transform((0.0, known[-1])))
    return float(np.clip(place[1], 0.0, 1.0))


def spread(heights: Sequence[float], gap: float) -> list[float]:
    """Move heights apart until neighbours differ by `gap`, keeping their order and their middle."""
    order = np.argsort(heights, kind="stable")
    steps = np.arange(len(order)) * gap
    # Heights at least `gap` apart are rising numbers after subtracting the steps; the nearest rising ones are the
    # means of the runs that fall (pool adjacent violators).
    pools: list[list[float]] = []
    for height in np.asarray(heights, dtype=np.float64)[order] - steps:
        pools.append([height])
        while len(pools) > 1 and np.mean(pools[-2]) > np.mean(pools[-1]):
            pools[-2:] = [pools[-2] + pools[-1]]
    placed = np.empty(len(order))
    placed[order] = np.concatenate([np.full(len(pool), np.mean(pool)) for pool in pools]) + steps
    return placed.tolist()


def band(axes: Axes, x: ArrayLike, low: ArrayLike, high: ArrayLike, color: Any) -> None:
    """Draw the band of a curve: its interval at each x (n,)."""
    axes.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0)


def keep_in_sight(axes: Axes, curves: ArrayLike) -> None:
    """Cut bands that leave the curves by more than half of the curves' range: those of two runs would flatten them."""
    known = np.asarray(curves, dtype=np.float64)
    known = known[np.isfinite(known)]
    if len(known) and (span := float(np.ptp(known))) > 0.0:
        low, high = axes.get_ylim()
        axes.set_ylim(max(low, known.min() - span / 2), min(high, known.max() + span / 2))


def mark_wobble_ends(axes: Axes, lines: Sequence[Line2D], ends: ArrayLike) -> bool:
    """A line across where all wobbles end together, else a ring on each curve; returns whether there are rings.

    Parameters
    ----------
    axes : Axes
        Over epochs.
    lines : sequence of Line2D
        One a condition.
    ends : (n_lines,)
        Epoch; NaN for a fixed robot. One beyond the last epoch is not marked.
    """
    ends = np.asarray(ends, dtype=np.float64)
    last = max(float(np.max(line.get_xdata(), initial=0.0)) for line in lines)
    known = np.unique(ends[ends <= last])
    if len(known) == 1:
        mark_epoch(axes, float(known[0]), "wobble ends")
    elif len(known):
        for line, end in zip(lines, ends, strict=True):
            _ring(axes, line, end)
    return len(known) > 1


def mark_epoch(axes: Axes, epoch: float, words: str = "") -> None:
    """A dashed line across the axes at an epoch, and what happens there above it."""
    axes.axvline(epoch, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0)
    if words:
        axes.annotate(
            words, (epoch, 1.0), (0, 3), xycoords=("data", "axes fraction"), textcoords="offset points",
            ha="center", va="bottom", color="0.3", fontsize=9,
        )  # fmt: skip


def _ring(axes: Axes, line: Line2D, epoch: float) -> None:
    x, y = (np.asarray(data, dtype=np.float64) for data in line.get_data())
    if len(x) and x[0] <= epoch <= x[-1]:
        axes.plot(
            [epoch], [np.interp(epoch, x, y)], marker="o", markersize=6, markerfacecolor="white",
            markeredgecolor=line.get_color(), linestyle="none",
        )  # fmt: skip


def count(numbers: ArrayLike, noun: str) -> str:
    """Say how many of each there are: ``100 runs``, ``1 run``, ``97 to 100 runs``."""
    known: NDArray[np.int64] = np.unique(np.asarray(numbers, dtype=np.int64))
    least, most = int(known[0]), int(known[-1])
    plural = "" if most == 1 else "s"
    return f"{least:,} {noun}{plural}" if least == most else f"{least:,} to {most:,} {noun}{plural}"
