"""Work-precision diagrams: error against run time, one curve a method (as in Hairer, Nørsett & Wanner 1993)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterMathtext, LogLocator, NullFormatter, StrMethodFormatter

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Of the integrators, in the order in which they come (Okabe & Ito 2008)."""

MARKERS = {"float32": "o", "float64": "s"}
TITLES = {
    "oscillator": "damped oscillator",
    "chain": "chain with a heavy end",
    "flight": "starfish in free flight",
    "drop": "drop on the floor",
    "gait": "gait, {duration:g} s",
    "long-gait": "gait, {duration:g} s",
}
POOLED = "all"
COLUMNS = 3
PERFORMING = ("gait", "long-gait")


def work_precision(table: pd.DataFrame) -> Figure:
    """Draw a panel for each scene of the table that `wobblesim accuracy` makes.

    The grey steps are the front: what no cheaper setting equals. Crosses at the upper edge are settings of which a
    trial diverged. A dotted line is how far the reference may be off; below it, an error says nothing.
    """
    scenes = list(dict.fromkeys(table["scene"]))
    colors: dict[str, str] = dict(zip(dict.fromkeys(table["integrator"]), COLORS, strict=False))
    columns = min(COLUMNS, len(scenes))
    n_rows = -(-len(scenes) // columns)
    figure = Figure(figsize=(max(5.5, 3.9 * columns), 3.4 * n_rows + 0.9), layout="constrained")
    panels = figure.subplots(n_rows, columns, squeeze=False)
    for axes, scene in zip(panels.flat, scenes, strict=False):
        _panel(axes, _of(table, scene), colors)
    for axes in panels.flat[len(scenes) :]:
        axes.set_visible(False)
    figure.legend(
        handles=_legend(table, colors), loc="outside lower center", ncols=5, frameon=False,
        fontsize=9, handlelength=2.5,
    )  # fmt: skip
    return figure


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG, the SVG with the same bytes for the same figure."""
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    FigureCanvasAgg(figure)
    figure.savefig(paths[0], dpi=130)
    FigureCanvasSVG(figure).print_svg(str(paths[1]), metadata={"Date": None})
    return paths


def _of(table: pd.DataFrame, scene: str) -> pd.DataFrame:
    """The rows of a scene that are drawn: of all morphologies if it has several, and without notes."""
    mine = table[(table["scene"] == scene) & (table["note"] == "")]
    pooled = mine[mine["morphology"] == POOLED]
    return pooled if len(pooled) else mine


def _panel(axes: Axes, rows: pd.DataFrame, colors: dict[str, str]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    _front(axes, rows[rows["front"]].sort_values("seconds"))
    for curve in _curves(rows):
        _curve(axes, curve, colors[curve["integrator"].iloc[0]])
    _shipped(axes, rows[rows["shipped"]])
    _doubts(axes, rows, colors)
    _failures(axes, rows, colors)
    scene, duration = str(rows["scene"].iloc[0]), float(rows["duration"].iloc[0])
    performing = scene in PERFORMING
    axes.set_title(TITLES.get(scene, scene).format(duration=duration), loc="left", fontsize=10)
    axes.set_ylabel("median error [body lengths]" if performing else "error of the path [u]", fontsize=9)
    axes.set_xlabel("run time of a simulated second of one lane [s]", fontsize=9)
    axes.tick_params(labelsize=8)
    _ticks(axes)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.92", linewidth=0.8)
    axes.set_axisbelow(True)


def _ticks(axes: Axes) -> None:
    """Label decades; where less than two are in sight, 1, 2 and 5 of each."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        wide = axis is axes.xaxis or np.log10(high / low) > 2
        axis.set_major_locator(LogLocator() if wide else LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(LogFormatterMathtext() if wide else StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def _curves(rows: pd.DataFrame) -> Iterator[pd.DataFrame]:
    keys = ["integrator", "precision", "iterations", "theta", "width"]
    for _, curve in rows.groupby(keys, dropna=False, sort=False):
        yield curve.sort_values("seconds")


def _curve(axes: Axes, curve: pd.DataFrame, color: str) -> None:
    """One method: thick if its other knob stands as shipped, thin if not; a star for one lane at a time."""
    first, known = curve.iloc[0], curve[np.isfinite(curve["error"] * curve["seconds"])]
    lone = first["width"] is not pd.NA and first["width"] == 1
    hollow = first["precision"] == "float64" and not lone
    axes.plot(
        known["seconds"], known["error"], color=color, marker="*" if lone else MARKERS[first["precision"]],
        markersize=11 if lone else 4.5, markerfacecolor="white" if hollow else color,
        linestyle="-" if first["precision"] == "float32" else (0, (4, 2)),
        linewidth=1.5 if first["usual"] else 0.7, alpha=1.0 if first["usual"] else 0.55,
    )  # fmt: skip


def _front(axes: Axes, best: pd.DataFrame) -> None:
    """Steps through the front: what the time up to each point buys."""
    if len(best):
        axes.step(
            best["seconds"], best["error"], where="post", color="0.82", linewidth=5, solid_capstyle="round",
            solid_joinstyle="round", zorder=1,
        )  # fmt: skip


def _shipped(axes: Axes, row: pd.DataFrame) -> None:
    axes.plot(
        row["seconds"], row["error"], marker="o", markersize=12, markerfacecolor="none", markeredgecolor="black",
        markeredgewidth=1.4, linestyle="none",
    )  # fmt: skip


def _doubts(axes: Axes, rows: pd.DataFrame, colors: dict[str, str]) -> None:
    """Dotted lines where a reference's own error stands, if that is near the errors."""
    performing = rows["scene"].iloc[0] in PERFORMING
    column = "reference_performance_error" if performing else "reference_path_error"
    least = rows["error"].min()
    for doubt, some in rows.groupby(column):
        if doubt > max(0.0, least / 30):
            names = list(dict.fromkeys(some["integrator"]))
            color = colors[names[0]] if len(names) < rows["integrator"].nunique() else "0.4"
            axes.axhline(doubt, color=color, linestyle=":", linewidth=1.2, zorder=0)


def _failures(axes: Axes, rows: pd.DataFrame, colors: dict[str, str]) -> None:
    """Crosses at the upper edge, at the run time that the setting's steps would take."""
    for _, lost in rows[rows["failures"] > 0].iterrows():
        alike = rows[(rows["integrator"] == lost["integrator"]) & (rows["precision"] == lost["precision"])]
        seconds = (alike["seconds"] * alike["dt"]).median() / lost["dt"]
        if np.isfinite(seconds):
            axes.plot(
                [seconds], [0.97], transform=axes.get_xaxis_transform(), marker="X", markersize=8,
                color=colors[lost["integrator"]], markeredgecolor="white", linestyle="none", clip_on=False,
            )  # fmt: skip


def _legend(table: pd.DataFrame, colors: dict[str, str]) -> list[Line2D]:
    shown = [Line2D([], [], color=color, linewidth=2.5, label=name) for name, color in colors.items()]
    shown += [
        Line2D([], [], color="0.3", marker="o", markersize=4.5, label="float32"),
        Line2D([], [], color="0.3", marker="s", markersize=4.5, markerfacecolor="white", linestyle=(0, (4, 2)),
               label="float64"),
        Line2D([], [], color="0.3", linewidth=0.7, label="other theta or iterations"),
        Line2D([], [], color="0.82", linewidth=5, label="front"),
        Line2D([], [], color="0.3", linestyle=":", label="reference's own error"),
        Line2D([], [], color="black", marker="o", markersize=12, markerfacecolor="none", linestyle="none",
               label="shipped default"),
    ]  # fmt: skip
    if (table["width"] == 1).any():
        shown.append(
            Line2D([], [], color="0.3", marker="*", markersize=11, linestyle="none", label="one lane at a time")
        )
    if (table["failures"] > 0).any():
        shown.append(Line2D([], [], color="0.3", marker="X", markersize=8, linestyle="none", label="a trial diverged"))
    return shown
