"""Means with their confidence, and the conditions of a study at a glance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from wobblesim.analysis.tables import Results

CONFIDENCE = 0.99
"""Of all intervals: the paper's (Benureau & Tani 2022, section III)."""


class Mean(NamedTuple):
    """A mean over runs and half the width of its confidence interval."""

    mean: NDArray[np.float64]
    half_width: NDArray[np.float64]
    n: NDArray[np.int64]


def mean_of(values: ArrayLike) -> Mean:
    """Mean over the first axis, with the interval of Student's t at `CONFIDENCE`.

    Parameters
    ----------
    values : (n, ...)
        A NaN is left out.

    Returns
    -------
    Mean
        Each (...); the mean of nothing is NaN, and so is the half width for fewer than two values.
    """
    values = np.asarray(values, dtype=np.float64)
    known = np.isfinite(values)
    n = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = total / n
        squares = np.where(known, (values - mean) ** 2, 0.0).sum(axis=0)
        error = np.sqrt(squares / (n - 1) / n)
        half_width = stdtrit(np.where(n > 1, n - 1, np.nan), 0.5 + CONFIDENCE / 2) * error
    return Mean(mean, half_width, n)


def baseline(conditions: list[str]) -> str:
    """The condition that the others are compared with: ``fixed`` if there is one, else the first."""
    return "fixed" if "fixed" in conditions else conditions[0]


SUMMARIZED = (
    "condition",
    "seed",
    "status",
    "performance",
    "path_before",
    "path_after",
    "diverged",
    "refined",
    "limited",
    "trials",
)


def summary(results: Results) -> pd.DataFrame:
    """One row a condition.

    Columns: ``condition``; ``runs``; ``excluded``, those without a score; ``mean``, ``half_width`` (of the 99 %
    interval) and ``median`` of the performance in body lengths; ``path_before`` and ``path_after``, mean search
    distances up to and after the end of the wobble, with half widths; ``trials``, and how many ``diverged``, were
    ``refined`` and were ``limited``; ``difference``: performance minus that of the `baseline` with the same seed, its
    mean over the ``pairs``, and the half width. Everything else of an excluded run still counts.
    """
    runs = results.runs(*SUMMARIZED)
    performance = runs.pivot(index="seed", columns="condition", values="performance")
    reference = performance[baseline(results.conditions)]
    rows = []
    for condition, mine in runs.groupby("condition", observed=True):
        is_baseline = condition == baseline(results.conditions)
        difference = np.full(1, np.nan) if is_baseline else (performance[condition] - reference).to_numpy()
        rows.append(_row(mine) | {"condition": str(condition)} | _named("difference", difference, n="pairs"))
    return pd.DataFrame(rows).set_index("condition").reset_index()


def _row(runs: pd.DataFrame) -> dict[str, float]:
    performance = runs["performance"].to_numpy()
    score = mean_of(performance)
    return {
        "runs": len(runs),
        "excluded": int(np.isnan(performance).sum()),
        "mean": float(score.mean),
        "half_width": float(score.half_width),
        "median": float(runs["performance"].median()),
        **_named("path_before", runs["path_before"].to_numpy()),
        **_named("path_after", runs["path_after"].to_numpy()),
        **{name: int(runs[name].sum()) for name in ("trials", "diverged", "refined", "limited")},
    }


def _named(name: str, values: NDArray[np.float64], n: str | None = None) -> dict[str, float]:
    found = mean_of(values)
    named = {name: float(found.mean), f"{name}_half_width": float(found.half_width)}
    return named | ({n: int(found.n)} if n else {})
