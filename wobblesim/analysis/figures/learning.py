"""Learning curves: the best trial of each epoch, averaged over the runs of a condition (the paper's figure 2 B)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import (
    ABOVE_WORDS,
    MOST_LABELS,
    Drawing,
    band,
    count,
    curves_figure,
    dress,
    keep_in_sight,
    looks,
    mark_wobble_ends,
    name_curves,
    over_epochs,
    performance_label,
)
from wobblesim.analysis.statistics import Mean, mean_of
from wobblesim.analysis.tables import Results

MOST_POINTS = 400
"""Points of a curve; with more epochs, each is the mean of several, or the picture would be all noise."""

LEAST_POINTS = 40
"""A curve of fewer points hides more than it shows."""


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
    every : Mean
        Over the runs, of each single epoch, (n_epochs,) each, body lengths.
    """

    condition: str
    epoch: NDArray[np.float64]
    best: Mean
    runs: int
    wobble_end: float
    every: Mean


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw one line a condition with its 99 % band, and mark where the wobble ends.

    With many epochs a thick line is the mean of several, and a thin one is each epoch. The table has a row for each
    point of both: ``condition``, ``epoch`` (the middle), how many ``epochs`` it is the mean of, ``mean``, ``low`` and
    ``high`` (99 % confidence; Student's t over the runs) in body lengths, and ``n``, the runs that have a score there.
    Bands are those of the thick lines, and drawn for up to ten conditions.
    """
    found, stride = curves(results, choice.shown(results))
    figure = curves_figure(len(found))
    axes = figure.add_subplot()
    seen = looks([curve.condition for curve in found], choice.reference(results))
    lines = [_draw(axes, curve, *look) for curve, look in zip(found, seen, strict=True)]
    if _banded(found):
        for curve, line in zip(found, lines, strict=True):
            band(axes, curve.epoch, curve.best.low, curve.best.high, line.get_color())
    over_epochs(axes, max(len(curve.every.mean) for curve in found) - 1)
    keep_in_sight(axes, np.concatenate([[*curve.best.mean, *curve.every.mean] for curve in found]))
    rings = mark_wobble_ends(axes, lines, [curve.wobble_end for curve in found])
    name_curves(axes, lines)
    _dress(axes, results, found, stride, rings)
    return Drawing(figure, pd.concat([_rows(curve, stride) for curve in found], ignore_index=True))


def curves(results: Results, conditions: Sequence[str] | None = None) -> tuple[list[Curve], int]:
    """The learning curves of a study, and the number of epochs that a point is the mean of."""
    chosen = results.conditions if conditions is None else list(conditions)
    epochs = results.epochs("condition", "seed", "epoch", "best")
    epochs = epochs[epochs["condition"].isin(chosen)]
    wobbles = results.runs("condition", "wobble.end", "wobble.period").groupby("condition", observed=True).first()
    stride = _stride(int(epochs["epoch"].max()) + 1, wobbles["wobble.period"].reindex(chosen).dropna().unique())
    found = [
        _curve(str(condition), mine, stride, float(wobbles.loc[condition, "wobble.end"]))
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
    every = epochs.pivot(index="epoch", columns="seed", values="best")
    point = every.index.to_numpy() // stride
    # An epoch in which all trials diverged has no best: a point is the mean of the others.
    best = every.groupby(point).mean()
    middle = pd.Series(every.index).groupby(point).agg(lambda of_point: (of_point.min() + of_point.max()) / 2)
    means = mean_of(best.to_numpy().T), mean_of(every.to_numpy().T)
    return Curve(condition, middle.to_numpy(np.float64), means[0], every.shape[1], wobble_end, means[1])


def _draw(axes: Axes, curve: Curve, color: str, dash: str) -> Line2D:
    mean = curve.best.mean
    if len(curve.every.mean) > len(mean):
        axes.plot(np.arange(len(curve.every.mean)), curve.every.mean, color=color, alpha=0.4, linewidth=0.5)
    return axes.plot(curve.epoch, mean, color=color, linestyle=dash, linewidth=1.6, label=curve.condition)[0]


def _banded(found: Sequence[Curve]) -> bool:
    """Whether the curves have bands: not where there is one run each, nor where they would hide the curves."""
    return len(found) <= MOST_LABELS and max(curve.runs for curve in found) > 1


def _dress(axes: Axes, results: Results, found: Sequence[Curve], stride: int, rings: bool) -> None:
    runs = [curve.runs for curve in found]
    bands = ", band: 99 % confidence" if _banded(found) else ""
    title = f"mean of {count(runs, 'run')} a condition{bands}{', ring: wobble ends' if rings else ''}"
    x = "epoch" if stride == 1 else f"epoch (thick: means of {stride} epochs, thin: each epoch)"
    dress(axes, x, f"best trial of the epoch\n({performance_label(results)})", title, pad=ABOVE_WORDS)


def _rows(curve: Curve, stride: int) -> pd.DataFrame:
    """The points of a curve, of the thick line and, if there is one, of the thin line."""
    points = _frame(curve.condition, curve.epoch, stride, curve.best)
    if stride == 1:
        return points
    every = _frame(curve.condition, np.arange(len(curve.every.mean), dtype=np.float64), 1, curve.every)
    return pd.concat([points, every], ignore_index=True)


def _frame(condition: str, epoch: NDArray[np.float64], epochs: int, best: Mean) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "condition": condition,
            "epoch": epoch,
            "epochs": epochs,
            "mean": best.mean,
            "low": best.low,
            "high": best.high,
            "n": best.n,
        }
    )
