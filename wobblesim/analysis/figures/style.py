"""How all figures look: colours, sizes, and how a figure becomes files."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

OKABE_ITO = ("#000000", "#E69F00", "#0072B2", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442")
"""Colours that people with any colour vision tell apart (Okabe & Ito 2008); the pale yellow last."""

DASHES = ("-", "--", "-.", ":")
INK, FAINT, GRID = "0.2", "0.45", "0.9"
"""Greys of text, of marks that explain, and of the grid."""

SEQUENTIAL, DIVERGING = "cividis", "PuOr"
"""Colour maps that keep their order for people with any colour vision."""

WIDTH = 8.0
"""Of a figure, inches."""

FORMATS = ("png", "svg", "pdf")
RESOLUTION = 150
"""Of a PNG, dots an inch."""

# The same figure is the same bytes: no date, and ids in the SVG that are counted instead of drawn by lot.
_METADATA: Mapping[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
_SETTINGS = {"svg.hashsalt": "wobblesim", "svg.fonttype": "none", "pdf.fonttype": 42}


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


def look(place: int) -> tuple[str, str]:
    """Colour and dashes of the curve at a place: no two of the first 32 are alike."""
    return OKABE_ITO[place % len(OKABE_ITO)], DASHES[place // len(OKABE_ITO) % len(DASHES)]


def dress(axes: Axes, x: str, y: str, title: str = "", grid: str = "y") -> None:
    """Name axes with their units, say in grey what is seen, and take away what says nothing."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title, loc="left", fontsize=9, color="0.3", pad=10)
    axes.spines[["top", "right"]].set_visible(False)
    if grid:
        axes.grid(axis=grid, color=GRID, linewidth=0.8)  # type: ignore[arg-type]
    axes.set_axisbelow(True)


def as_bytes(figure: Figure, form: str) -> bytes:
    """A figure as a file of one of `FORMATS`; the same bytes for the same figure."""
    content = io.BytesIO()
    with mpl.rc_context(_SETTINGS):
        figure.savefig(content, format=form, dpi=RESOLUTION, metadata=_METADATA[form])
    return content.getvalue()


def files_of(drawing: Drawing, name: str, formats: Sequence[str] = FORMATS) -> dict[Path, bytes]:
    """The files of a drawing by name: its pictures, and its table as CSV."""
    made = {Path(f"{name}.{form}"): as_bytes(drawing.figure, form) for form in formats}
    return made | {Path(f"{name}.csv"): drawing.table.to_csv(index=False, lineterminator="\n").encode()}
