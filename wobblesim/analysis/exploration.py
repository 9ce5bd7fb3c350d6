"""How far and where the search goes: principal components, moving averages, search distances (the paper's figure 4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import Results

WINDOW = 101
"""Epochs of a moving average: the paper's (Benureau & Tani 2022, figure 4 B)."""

WINDOWS_OF_A_RUN = 3
"""Windows that are to fit into a run, one after the other; in a shorter one they are made shorter."""


class Components(NamedTuple):
    """The first two principal components of points.

    Attributes
    ----------
    scores : (n, 2)
        Of each point, in the units of its coordinates.
    axes : (2, d)
        Unit vectors, the directions of the components.
    explained : (2,)
        Share of the variance of all points that lies along each.
    """

    scores: NDArray[np.float64]
    axes: NDArray[np.float64]
    explained: NDArray[np.float64]


def principal_components(points: ArrayLike) -> Components:
    """Project points on the plane in which they vary most (Pearson 1901), by a singular value decomposition.

    The sign of a component is free: here its largest loading is positive, so that the same points give the same
    picture.

    Parameters
    ----------
    points : (n, d)
        Coordinates with one unit, for they are not scaled; d is at least 2.

    Returns
    -------
    Components
        Points that are all the same explain nothing: their shares are NaN.
    """
    points = np.asarray(points, dtype=np.float64)
    centred = points - points.mean(axis=0)
    # Fewer points than coordinates have fewer components, and the rest of a basis makes up for them.
    _, deviations, loadings = np.linalg.svd(centred, full_matrices=len(points) < points.shape[1])
    axes = loadings[:2]
    axes = axes * np.where(np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1) < 0, -1.0, 1.0)
    variances = np.zeros(2)
    variances[: min(2, len(deviations))] = np.square(deviations[:2])
    total = np.square(deviations).sum()
    explained = variances / total if total > 0.0 else np.full(2, np.nan)
    return Components(centred @ axes.T, axes, explained)


def window_of(epochs: int) -> int:
    """Epochs of a moving average over a run: `WINDOW`, or an odd number that fits into a short run three times."""
    if epochs >= WINDOWS_OF_A_RUN * WINDOW:
        return WINDOW
    fitting = max(1, epochs // WINDOWS_OF_A_RUN)
    return fitting - (fitting + 1) % 2


def moving_average(values: ArrayLike, window: int) -> NDArray[np.float64]:
    """Means of so many values one after the other along the first axis, each in the place of the one in its middle.

    Parameters
    ----------
    values : (n, ...)
        At most two axes.
    window : int
        Odd.

    Returns
    -------
    array of the same shape
        NaN where the window does not lie within the values, or holds a NaN.
    """
    values = np.asarray(values, dtype=np.float64)
    averages = pd.DataFrame(values).rolling(window, center=True).mean()
    return averages.to_numpy().reshape(values.shape)


def search_distances(results: Results) -> pd.DataFrame:
    """The search distances in the text of the paper (section III-D): means over the runs of each condition.

    Returns
    -------
    DataFrame
        One row a condition: ``condition``; ``split``, the last epoch that counts as before, which is where the wobble
        ends or half the epochs of a fixed robot; ``before`` and ``after``, means of the search distance along the
        ancestry of the final best behaviour, with ``before_half_width`` and ``after_half_width`` of their 99 %
        intervals (Student's t); ``n`` runs.
    """
    runs = results.runs("condition", "path_before", "path_after", *OF_SPLIT)
    return pd.DataFrame([_distances(str(name), mine) for name, mine in runs.groupby("condition", observed=True)])


OF_SPLIT = ("wobble.end", "learning.epochs")


def _distances(condition: str, runs: pd.DataFrame) -> dict[str, object]:
    before, after = mean_of(runs["path_before"]), mean_of(runs["path_after"])
    return {
        "condition": condition,
        "split": split_of(runs.iloc[0]),
        "before": float(before.mean),
        "before_half_width": float(before.half_width),
        "after": float(after.mean),
        "after_half_width": float(after.half_width),
        "n": len(runs),
    }


def split_of(run: pd.Series) -> int:
    """The last epoch of ``path_before``, from the columns `OF_SPLIT` of a run: that of `wobblesim.learning` `Setup`."""
    end = run["wobble.end"]
    return int(run["learning.epochs"] // 2 if pd.isna(end) else end)
