"""The search distance from epoch to epoch, as a moving average (the paper's figure 4 B)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.exploration import moving_average, window_of
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
)
from wobblesim.analysis.statistics import Mean, mean_of
from wobblesim.analysis.tables import Results

WIDE, DEEPEST = 30.0, 1e5
"""Ratios of the largest to the least distance: from which on the axis is logarithmic, and how far it goes at most."""


class Curve(NamedTuple):
    """The search distance of a condition: epochs (n,), means over its runs (n,) each, and the window of each mean."""

    condition: str
    epoch: NDArray[np.int64]
    distance: Mean
    window: int
    runs: int


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw the moving average over epochs of the distance from the best behaviour of an epoch to that of the next.

    The average is made for each run, over 101 epochs (`wobblesim.analysis.exploration.window_of`), and only where all
    of them are there: the curves begin and end half a window from the ends of the run. A line is the mean over the
    runs, its band (for up to ten conditions) the 99 % interval of Student's t. Distances are Euclidean, of genotypes:
    amplitudes in [0, 1] and offsets in turns.

    The table has a row for each point: ``condition``, ``epoch``, ``window``, ``mean``, ``low``, ``high``, ``n``.
    """
    check(results, choice)
    found = curves(results, choice.shown(results))
    figure = curves_figure(len(found))
    axes = figure.add_subplot()
    seen = looks([curve.condition for curve in found], choice.reference(results))
    lines = [_draw(axes, curve, *look) for curve, look in zip(found, seen, strict=True)]
    banded = len(found) <= MOST_LABELS and max(curve.runs for curve in found) > 1
    if banded:
        for curve, line in zip(found, lines, strict=True):
            band(axes, curve.epoch, curve.distance.low, curve.distance.high, line.get_color())
    over_epochs(axes, max(curve.epoch[-1] + curve.window // 2 for curve in found))
    _scale(axes, found)
    rings = mark_wobble_ends(axes, lines, _ends(results, found))
    name_curves(axes, lines)
    runs, windows = count([curve.runs for curve in found], "run"), count([curve.window for curve in found], "epoch")
    bands = ", band: 99 % confidence" if banded else ""
    title = f"moving average over {windows}, mean of {runs} a condition{bands}{', ring: wobble ends' if rings else ''}"
    dress(axes, "epoch", "search distance of an epoch\n(from best to best behaviour)", title, pad=ABOVE_WORDS)
    return Drawing(figure, pd.concat([_rows(curve) for curve in found], ignore_index=True))


def check(results: Results, choice: Choice) -> None:
    """Refuse a study whose runs have one epoch: nothing lies between the best behaviours of two.

    Raises
    ------
    FigureError
    """
    runs = results.runs("condition", "epochs")
    if runs.loc[runs["condition"].isin(choice.shown(results)), "epochs"].min() < LEAST_EPOCHS:
        raise FigureError(f"a search has a distance from epoch to epoch, and runs need {LEAST_EPOCHS} epochs for it")


LEAST_EPOCHS = 2


def curves(results: Results, conditions: Sequence[str]) -> list[Curve]:
    """The moving averages of conditions."""
    epochs = results.epochs("condition", "seed", "epoch", "step_distance")
    epochs = epochs[epochs["condition"].isin(conditions) & (epochs["epoch"] > 0)]
    return [_curve(str(condition), mine) for condition, mine in epochs.groupby("condition", observed=True)]


def _curve(condition: str, epochs: pd.DataFrame) -> Curve:
    distance = epochs.pivot(index="epoch", columns="seed", values="step_distance")
    window = window_of(1 + int(distance.index[-1]))
    whole = slice(window // 2, len(distance) - window // 2)
    averages = moving_average(distance.to_numpy(), window)[whole]
    return Curve(condition, distance.index.to_numpy(np.int64)[whole], mean_of(averages.T), window, distance.shape[1])


def _draw(axes: Axes, curve: Curve, color: str, dash: str) -> Line2D:
    return axes.plot(
        curve.epoch, curve.distance.mean, color=color, linestyle=dash, linewidth=1.6, label=curve.condition
    )[0]


def _scale(axes: Axes, found: Sequence[Curve]) -> None:
    """Make the axis logarithmic if distances span decades, else begin it at zero; bands of few runs are cut."""
    means = np.concatenate([curve.distance.mean for curve in found])
    positive = means[means > 0.0]
    if len(positive) and positive.max() > WIDE * positive.min():
        # What is zero, and the lower edge of a band that reaches it, lies on the lower edge of the picture.
        axes.set_yscale("log", nonpositive="clip")
        axes.set_ylim(max(positive.min() / 2, positive.max() / DEEPEST), positive.max() * 2)
        return
    keep_in_sight(axes, means)
    axes.set_ylim(bottom=0.0)


def _ends(results: Results, found: Sequence[Curve]) -> list[float]:
    """Epochs at which the wobbles end; NaN for a fixed robot."""
    ends = results.runs("condition", "wobble.end").groupby("condition", observed=True)["wobble.end"].first()
    return [float(ends[curve.condition]) for curve in found]


def _rows(curve: Curve) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "condition": curve.condition,
            "epoch": curve.epoch,
            "window": curve.window,
            "mean": curve.distance.mean,
            "low": curve.distance.low,
            "high": curve.distance.high,
            "n": curve.distance.n,
        }
    )
