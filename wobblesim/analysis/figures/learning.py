"""Learning curves: the best trial of each epoch, averaged over the runs of a condition (the paper's figure 2 B)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from wobblesim.analysis.statistics import Mean, mean_of
from wobblesim.analysis.tables import Results

OKABE_ITO = ("#000000", "#E69F00", "#0072B2", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442")
"""Colours that people with any colour vision tell apart (Okabe & Ito 2008); the pale yellow last."""

DASHES = ("-", "--", "-.", ":")
MOST_POINTS = 400
"""Points of a curve; with more epochs, each is the mean of several, or the picture would be all noise."""

LEAST_POINTS = 40
"""A curve of fewer points hides more than it shows."""

MOST_LABELS = 10
"""Curves that are named at their ends; more of them have a legend."""


@dataclass(frozen=True, eq=False)
class Curve:
    """The learning curve of a condition.

    Attributes
    ----------
    condition : str
    epoch : (n_points,)
        Middle of the epochs that a point stands for.
    best : Mean
        Over the runs, (n_points,) each, body lengths.
    runs : int
    wobble_end : float
        Epoch; NaN for a fixed robot.
    every : (n_epochs,)
        The mean best of each single epoch, body lengths.
    """

    condition: str
    epoch: NDArray[np.float64]
    best: Mean
    runs: int
    wobble_end: float
    every: NDArray[np.float64]


def curves(results: Results) -> tuple[list[Curve], int]:
    """The learning curves of a study, and the number of epochs that a point is the mean of."""
    epochs = results.epochs("condition", "seed", "epoch", "best")
    ends = results.runs("condition", "wobble.end").groupby("condition", observed=True)["wobble.end"].first()
    stride = _stride(int(epochs["epoch"].max()) + 1, results.runs("wobble.period")["wobble.period"].dropna().unique())
    found = [
        _curve(str(condition), mine, stride, float(ends[condition]))
        for condition, mine in epochs.groupby("condition", observed=True)
    ]
    return found, stride


def _stride(epochs: int, periods: NDArray[np.float64]) -> int:
    """Epochs that a point stands for: one if they are few, else whole periods of all wobbles if these are short.

    A mean over a whole period shows what was learned and not where in its wobble the robot is.
    """
    least = -(-epochs // MOST_POINTS)
    common = math.lcm(*(max(1, round(period)) for period in periods))
    if least > 1 and common <= epochs / LEAST_POINTS:
        return -(-least // common) * common
    return least


def _curve(condition: str, epochs: pd.DataFrame, stride: int, wobble_end: float) -> Curve:
    point = epochs["epoch"] // stride
    # An epoch in which all trials diverged has no best: a point is the mean of the others.
    best = epochs.groupby([epochs["seed"], point])["best"].mean().unstack("seed")
    middle = epochs.groupby(point)["epoch"].agg(lambda of_point: (of_point.min() + of_point.max()) / 2)
    every = epochs.groupby("epoch")["best"].mean().to_numpy(np.float64)
    return Curve(condition, middle.to_numpy(np.float64), mean_of(best.to_numpy().T), best.shape[1], wobble_end, every)


def learning_curves(results: Results) -> Figure:
    """Draw one line a condition with its 99 % band, and mark where the wobble ends."""
    found, stride = curves(results)
    figure = Figure(figsize=(8.0, 4.8), layout="constrained")
    axes = figure.add_subplot()
    lines = [
        _draw(axes, curve, OKABE_ITO[i % len(OKABE_ITO)], DASHES[i // len(OKABE_ITO) % len(DASHES)])
        for i, curve in enumerate(found)
    ]
    _mark_wobble_ends(axes, found, lines)
    _name_curves(axes, found, lines)
    _name_axes(axes, results, found, stride)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG."""
    FigureCanvasAgg(figure).print_png(str(path))


def _draw(axes: Axes, curve: Curve, color: str, dash: str) -> Line2D:
    mean, half_width, _ = curve.best
    axes.fill_between(curve.epoch, mean - half_width, mean + half_width, color=color, alpha=0.15, linewidth=0)
    if len(curve.every) > len(mean):
        axes.plot(np.arange(len(curve.every)), curve.every, color=color, alpha=0.4, linewidth=0.5)
    return axes.plot(curve.epoch, mean, color=color, linestyle=dash, linewidth=1.6, label=curve.condition)[0]


def _mark_wobble_ends(axes: Axes, found: list[Curve], lines: list[Line2D]) -> None:
    """A line across where all wobbles end together, else a dot on each curve."""
    last = max(curve.epoch[-1] for curve in found)
    ends = {curve.wobble_end for curve in found if curve.wobble_end <= last}
    if len(ends) == 1:
        (end,) = ends
        axes.axvline(end, color="0.45", linewidth=1.0, linestyle=(0, (4, 3)), zorder=0)
        axes.annotate(
            "wobble ends", (end, 1.0), (0, 3), xycoords=("data", "axes fraction"), textcoords="offset points",
            ha="center", va="bottom", color="0.3", fontsize=9,
        )  # fmt: skip
        return
    for curve, line in zip(found, lines, strict=True):
        if curve.wobble_end <= last:
            height = np.interp(curve.wobble_end, curve.epoch, curve.best.mean)
            axes.plot(
                [curve.wobble_end], [height], marker="o", markersize=6, markerfacecolor="white",
                markeredgecolor=line.get_color(), linestyle="none",
            )  # fmt: skip


def _name_curves(axes: Axes, found: list[Curve], lines: list[Line2D]) -> None:
    if len(found) > MOST_LABELS:
        axes.legend(
            handles=lines, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8, handlelength=3
        )
        return
    heights = _spread([_last_known(curve.best.mean) for curve in found], _label_height(axes))
    for curve, line, height in zip(found, lines, heights, strict=True):
        axes.annotate(
            curve.condition, (1.0, height), (6, 0), xycoords=("axes fraction", "data"), textcoords="offset points",
            ha="left", va="center", color=line.get_color(), fontsize=10,
        )  # fmt: skip


def _last_known(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else 0.0


def _label_height(axes: Axes) -> float:
    """Height of a line of text, in the units of the y axis."""
    low, high = axes.get_ylim()
    return (high - low) / 20


def _spread(heights: list[float], gap: float) -> list[float]:
    """Move heights apart until neighbours differ by `gap`, keeping their order and their middle."""
    order = np.argsort(heights, kind="stable")
    wanted = np.array(heights)[order]
    steps = np.arange(len(wanted)) * gap
    # Heights at least `gap` apart are rising numbers after subtracting the steps; the nearest rising ones are the
    # means of the runs that fall (pool adjacent violators).
    pools: list[list[float]] = []
    for height in wanted - steps:
        pools.append([height])
        while len(pools) > 1 and np.mean(pools[-2]) > np.mean(pools[-1]):
            pools[-2:] = [pools[-2] + pools[-1]]
    moved = np.concatenate([np.full(len(pool), np.mean(pool)) for pool in pools]) + steps
    placed = np.empty(len(wanted))
    placed[order] = moved
    return placed.tolist()


def _name_axes(axes: Axes, results: Results, found: list[Curve], stride: int) -> None:
    durations = results.runs("trial.duration")["trial.duration"].unique()
    duration = f"{durations[0]:g} s" if len(durations) == 1 else "a trial"
    axes.set_xlabel("epoch" if stride == 1 else f"epoch (thick: means of {stride} epochs, thin: each epoch)")
    axes.set_ylabel(f"best trial of the epoch\n(body lengths in {duration})")
    runs = sorted({curve.runs for curve in found})
    number = f"{runs[0]}" if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    plural = "run" if runs == [1] else "runs"
    band = ", band: 99 % confidence" if runs[-1] > 1 else ""
    dots = ", ring: wobble ends" if len({c.wobble_end for c in found if np.isfinite(c.wobble_end)}) > 1 else ""
    axes.set_title(f"mean of {number} {plural} a condition{band}{dots}", loc="left", fontsize=9, color="0.3", pad=16)
    axes.set_xlim(0, max(curve.epoch[-1] for curve in found) + stride / 2)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
