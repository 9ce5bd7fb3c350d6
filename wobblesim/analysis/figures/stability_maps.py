"""Pictures of `wobblesim stability`: spectral radii of one spring, classes over the morphology box, safe wobbles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

COLORS = {
    "ok": "#009E73",
    "not converged": "#F0E442",
    "limited": "#56B4E9",
    "gains energy": "#E69F00",
    "too fast": "#CC79A7",
    "diverged": "#000000",
}
"""Okabe & Ito (2008), from harmless to useless; they differ in lightness too."""

METHOD_COLORS = {"midpoint": "#0072B2", "impulse": "#D55E00", "explicit": "#000000"}
TOP = 1.5  # of the axis of spectral radii
GREY = "0.35"


def save(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as PNG and SVG beside it; return both paths."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path.with_suffix(".png"))
    # No date and no random names inside: the same figure has the same bytes.
    with rc_context({"svg.hashsalt": "wobblesim"}):
        figure.savefig(path.with_suffix(".svg"), dpi=200, metadata={"Date": None})
    return [path.with_suffix(".png"), path.with_suffix(".svg")]


# --- one spring ------------------------------------------------------------------------------------------------------


def spring_figure(curves: pd.DataFrame, ladder: pd.DataFrame, limits: pd.DataFrame) -> Figure:
    """Spectral radius over omega h: lines are theory, dots and vertical lines are measured."""
    zetas = sorted(curves["zeta"].unique())
    figure = Figure(figsize=(9.0, 3.9), layout="constrained")
    panels = figure.subplots(1, len(zetas), sharey=True, squeeze=False)[0]
    for axes, zeta in zip(panels, zetas, strict=True):
        _spring_panel(axes, *(frame[frame["zeta"] == zeta] for frame in (curves, ladder, limits)))
        kind = {0.0: "undamped (ζ = 0)", 1.0: "critically damped (ζ = 1)"}.get(zeta, f"ζ = {zeta:g}")
        axes.set_title(kind, loc="left", fontsize=10)
    panels[0].set_ylabel("spectral radius of one step")
    methods = list(dict.fromkeys(curves["integrator"]))
    handles = [Line2D([], [], color=METHOD_COLORS.get(name, GREY), label=f"{name}, theory") for name in methods]
    handles += [
        Line2D([], [], color=GREY, marker="o", linestyle="none", markersize=4, label="measured"),
        Line2D([], [], color=GREY, linestyle="--", linewidth=1, label="measured limit"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    return figure


def _spring_panel(axes: Axes, curves: pd.DataFrame, ladder: pd.DataFrame, limits: pd.DataFrame) -> None:
    axes.axhspan(1.0, TOP, color="0.93", zorder=0)
    axes.text(0.02, 0.97, "grows", transform=axes.transAxes, va="top", color=GREY, fontsize=9)
    for name, curve in curves.groupby("integrator", sort=False):
        color = METHOD_COLORS.get(str(name), GREY)
        axes.plot(curve["omega_h"], curve["radius"], color=color, linewidth=1.6)
        rungs = ladder[(ladder["integrator"] == name) & (ladder["measured"] <= TOP)]
        axes.plot(rungs["omega_h"], rungs["measured"], "o", color=color, markersize=4)
        limit = limits.loc[limits["integrator"] == name, "measured"].item()
        if np.isfinite(limit):
            axes.axvline(limit, color=color, linestyle="--", linewidth=1)
            axes.annotate(f"{limit:.3f}", (limit, 1.3), (8, 0), textcoords="offset points", fontsize=9, color=color)
    axes.set_xscale("log")
    axes.set_xlim(curves["omega_h"].min(), curves["omega_h"].max())
    axes.set_ylim(0.0, TOP)
    axes.set_xlabel("ω h (frequency times step)")
    axes.spines[["top", "right"]].set_visible(False)


# --- the box ---------------------------------------------------------------------------------------------------------


def box_figures(cells: pd.DataFrame) -> Iterator[tuple[str, Figure]]:
    """Name and figure for each integrator and precision."""
    for (integrator, precision), of in cells.groupby(["integrator", "precision"], sort=False):
        yield f"box-{integrator}-{precision}", _box_figure(of, f"{integrator}, {precision}")


def _box_figure(cells: pd.DataFrame, title: str) -> Figure:
    steps, sizes = sorted(cells["dt"].unique(), reverse=True), sorted(cells["size"].unique())
    figure, panels = _panels(len(steps), len(sizes), title)
    colors, names = ListedColormap(list(COLORS.values())), list(COLORS)
    for i, dt in enumerate(steps):
        for j, size in enumerate(sizes):
            of = cells[(cells["dt"] == dt) & (cells["size"] == size)]
            codes = of.assign(code=of["class"].map(names.index))
            _map(panels[i][j], codes, "code", cmap=colors, vmin=-0.5, vmax=len(names) - 0.5)
            panels[i][j].set_title(f"dt {dt:g} s, size × {size:g}", loc="left", fontsize=9)
    handles = [*_class_patches(), _adult_mark()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    return figure


def explicit_figure(limits: pd.DataFrame) -> Figure:
    """The largest stable step of `explicit` over the box."""
    sizes = sorted(limits["size"].unique())
    figure, panels = _panels(1, len(sizes), "explicit: largest stable step")
    norm, image = LogNorm(limits["limit"].min(), limits["limit"].max()), None
    for axes, size in zip(panels[0], sizes, strict=True):
        image = _map(axes, limits[limits["size"] == size], "limit", cmap="viridis", norm=norm)
        axes.set_title(f"size × {size:g}", loc="left", fontsize=9)
    assert image is not None
    figure.colorbar(image, ax=list(panels[0]), label="largest stable step (s)", shrink=0.9)
    figure.legend(handles=[_adult_mark()], loc="outside lower center", frameon=False, fontsize=9)
    return figure


def _panels(n_rows: int, n_columns: int, title: str) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(max(6.5, 1.2 + 2.7 * n_columns), 1.2 + 2.3 * n_rows), layout="constrained")
    figure.suptitle(title, x=0.02, ha="left", fontsize=11)
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels[-1]:
        axes.set_xlabel("mass (factor)")
    for axes in panels[:, 0]:
        axes.set_ylabel("stiffness (factor)")
    return figure, panels


def _map(axes: Axes, cells: pd.DataFrame, value: str, **colors: Any):
    grid = cells.pivot_table(index="stiffness", columns="mass", values=value)
    x, y = _edges(grid.columns.to_numpy(float)), _edges(grid.index.to_numpy(float))
    image = axes.pcolormesh(x, y, grid.to_numpy(), edgecolors="white", linewidth=0.5, rasterized=True, **colors)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.plot([1.0], [1.0], marker="o", markersize=6, markerfacecolor="none", markeredgecolor="white", zorder=3)
    axes.plot([1.0], [1.0], marker="o", markersize=4, markerfacecolor="white", markeredgecolor="black", zorder=4)
    return image


def _edges(centers: np.ndarray) -> np.ndarray:
    """Edges of cells around centres that are evenly spaced in the logarithm, or nearly."""
    log = np.log(centers)
    if len(log) == 1:
        return centers[0] * np.array([0.5, 2.0])
    middle = 0.5 * (log[1:] + log[:-1])
    return np.exp(np.concatenate([[1.5 * log[0] - 0.5 * log[1]], middle, [1.5 * log[-1] - 0.5 * log[-2]]]))


def _class_patches() -> list[Patch]:
    return [Patch(facecolor=color, edgecolor="0.6", label=name) for name, color in COLORS.items()]


def _adult_mark() -> Line2D:
    return Line2D(
        [], [], marker="o", markersize=5, markerfacecolor="white", markeredgecolor="black", linestyle="none",
        label="the adult",
    )  # fmt: skip


# --- safe wobbles ----------------------------------------------------------------------------------------------------


def factor_figure(cells: pd.DataFrame) -> Figure:
    """Classes over the factor on one dimension: a row of panels an integrator, a line of cells a step."""
    integrators, dimensions = (list(dict.fromkeys(cells[key])) for key in ("integrator", "dimension"))
    steps = sorted(cells["dt"].unique())
    figure = Figure(figsize=(10.0, 1.0 + (0.8 + 0.28 * len(steps)) * len(integrators)), layout="constrained")
    panels = figure.subplots(len(integrators), len(dimensions), sharex=True, sharey=True, squeeze=False)
    for row, integrator in zip(panels, integrators, strict=True):
        for axes, dimension in zip(row, dimensions, strict=True):
            of = cells[(cells["integrator"] == integrator) & (cells["dimension"] == dimension)]
            _strips(axes, of, steps)
            axes.set_title(f"{integrator}: {dimension}", loc="left", fontsize=9)
        row[0].set_ylabel("dt (s)")
    for axes in panels[-1]:
        axes.set_xlabel("factor")
    handles = _class_patches()
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    return figure


def _strips(axes: Axes, cells: pd.DataFrame, steps: Sequence[float]) -> None:
    names = list(COLORS)
    grid = cells.assign(code=cells["class"].map(names.index)).pivot_table(index="dt", columns="factor", values="code")
    edges = np.arange(len(steps) + 1) - 0.5
    axes.pcolormesh(
        _edges(grid.columns.to_numpy(float)), edges, grid.reindex(steps).to_numpy(),
        cmap=ListedColormap(list(COLORS.values())), vmin=-0.5, vmax=len(names) - 0.5,
        edgecolors="white", linewidth=0.5, rasterized=True,
    )  # fmt: skip
    axes.set_xscale("log")
    axes.axvline(1.0, color="black", linewidth=0.8, linestyle=":")
    axes.set_yticks(range(len(steps)), [f"{dt:g}" for dt in steps])
    axes.tick_params(axis="y", length=0)
