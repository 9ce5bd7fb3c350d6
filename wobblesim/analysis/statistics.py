"""Means, medians and effects with their confidence, and the conditions of a study at a glance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri, owens_t, stdtrit

from wobblesim.analysis.tables import Results

CONFIDENCE = 0.99
"""Of all intervals: the paper's (Benureau & Tani 2022, section III)."""


# --- of samples ----------------------------------------------------------------------------------------------------


class Mean(NamedTuple):
    """A mean over runs and half the width of its confidence interval."""

    mean: NDArray[np.float64]
    half_width: NDArray[np.float64]
    n: NDArray[np.int64]

    @property
    def low(self) -> NDArray[np.float64]:
        """Lower end of the interval."""
        return self.mean - self.half_width

    @property
    def high(self) -> NDArray[np.float64]:
        """Upper end of the interval."""
        return self.mean + self.half_width


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


class Median(NamedTuple):
    """A median over runs and its confidence interval."""

    median: float
    low: float
    high: float
    n: int


def median_of(values: ArrayLike) -> Median:
    """Median, with the exact interval between two of the values, whatever their distribution, at `CONFIDENCE`.

    The interval of `scipy.stats.quantile_test` (Conover 1999, Practical Nonparametric Statistics, section 3.2): how
    many of n values lie below the true median is binomial. It holds the median with at least the confidence asked
    for.

    Parameters
    ----------
    values : (n,)
        A NaN is left out.

    Returns
    -------
    Median
        Of NaNs for no values. The interval is NaN for fewer than 8: even that from the least to the largest of 7 holds
        the median only 63 times in 64.
    """
    from scipy.stats import quantile_test

    values = np.asarray(values, dtype=np.float64)
    values = values[np.isfinite(values)]
    if not len(values):
        return Median(np.nan, np.nan, np.nan, 0)
    interval = quantile_test(values).confidence_interval(CONFIDENCE)
    return Median(float(np.median(values)), float(interval.low), float(interval.high), len(values))


# --- of pairs ------------------------------------------------------------------------------------------------------


class Effect(NamedTuple):
    """A matched-pairs rank-biserial correlation and its confidence interval."""

    effect: float
    low: float
    high: float
    n: int


def rank_biserial(differences: ArrayLike, confidence: float = CONFIDENCE) -> Effect:
    """Matched-pairs rank-biserial correlation: how one-sided the signed ranks of differences are (Kerby 2014).

    The sum of the ranks of the positive differences minus that of the negative ones, as a share of both: 1 if all are
    positive, 0 if it is even, -1 if all are negative. Ranks are those of Wilcoxon's test: of the size of the
    differences, zeros left out, ties with their mean rank.

    The interval is Wilson's (1927) for this statistic. It holds the effects from which the one found is no further
    than the normal quantile times their own standard deviation; that is the standard deviation under a normal
    distribution of the same effect (`_moments`), at no effect the one of Wilcoxon's test. Near an effect of 1 an
    interval from the standard deviation at 0, as R's effectsize gives it, is far too short.

    Parameters
    ----------
    differences : (n,)
        A NaN is left out.
    confidence : float
        In (0, 1).

    Returns
    -------
    Effect
        `n` counts the differences that are not zero; all else is NaN if there is none.
    """
    from scipy.stats import rankdata

    differences = np.asarray(differences, dtype=np.float64)
    differences = differences[np.isfinite(differences) & (differences != 0.0)]
    n = len(differences)
    if not n:
        return Effect(np.nan, np.nan, np.nan, 0)
    ranks = rankdata(np.abs(differences))
    effect = float((np.sign(differences) * ranks).sum() / ranks.sum())
    quantile = float(ndtri(0.5 + confidence / 2))
    return Effect(effect, _lowest(effect, n, quantile), -_lowest(-effect, n, quantile), n)


FARTHEST = 8.0
"""Standard deviations that a distribution is moved, at most: then all differences have one sign."""


def _lowest(effect: float, n: int, quantile: float) -> float:
    """The smallest effect from which the one found is no further than so many standard deviations."""
    if effect <= -1.0:
        return -1.0

    def excess(shift: float, quantile: float = quantile) -> float:
        mean, deviation = _moments(shift, n)
        return mean + quantile * deviation - effect

    # The sum of mean and deviations rises through the effect once below the shift whose mean is the effect, or next
    # to it: one rank off, for an effect of 1 is reached nowhere.
    reached = min(effect, 1.0 - 2.0 / (n * (n + 1)))
    highest = brentq(lambda shift: _moments(shift, n)[0] - reached, -FARTHEST, FARTHEST)
    return _moments(brentq(excess, -FARTHEST, highest), n)[0]


def _moments(shift: float, n: int) -> tuple[float, float]:
    """Mean and standard deviation of the rank-biserial correlation of n values, normal with this mean and variance 1.

    The sum of the positive ranks counts the pairs i <= j with a positive sum of values (Tukey 1949). Its mean and
    variance follow from the probabilities that one value, a sum of two, and two sums with one value in common are
    positive (Lehmann 1975, Nonparametrics, on the power of Wilcoxon's signed-rank test). The third of these is a
    bivariate normal with correlation 1/2 (Owen 1956).
    """
    one, two = ndtr(shift), ndtr(np.sqrt(2.0) * shift)
    three = two - 2.0 * owens_t(np.sqrt(2.0) * shift, 1.0 / np.sqrt(3.0))
    pairs, total = n * (n - 1) / 2, n * (n + 1) / 2
    variance = n * one * (1.0 - one) + pairs * (2.0 * (one - two) ** 2 + 3.0 * two * (1.0 - two))
    variance += 2.0 * pairs * (n - 2) * (three - two**2)
    mean = 2.0 * (n * one + pairs * two) / total - 1.0
    return float(mean), float(2.0 * np.sqrt(max(variance, 0.0)) / total)


def holm(p: ArrayLike) -> NDArray[np.float64]:
    """p-values of a family of tests, corrected as Holm (1979): the least times n, the next times n - 1, and so on.

    Where each corrected value is held against a threshold, the probability of any false discovery in the family is at
    most the threshold, however the tests depend on one another. SciPy has corrections for the false discovery rate
    only.

    Parameters
    ----------
    p : (n,)
        NaN for a test that was not made: it stays NaN and does not count.
    """
    p = np.asarray(p, dtype=np.float64)
    order = np.argsort(p)[: np.isfinite(p).sum()]  # NaNs come last
    corrected = np.full(p.shape, np.nan)
    corrected[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1.0)
    return corrected


# --- of conditions -------------------------------------------------------------------------------------------------


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
"""Columns of the table of runs that a summary is made of."""


def describe(results: Results) -> pd.DataFrame:
    """One row a condition.

    Columns: ``condition``; ``runs``; ``excluded``, those without a score, whose trials of the last epoch all diverged;
    ``mean``, ``half_width`` (of the 99 % interval), ``median``, ``median_low`` and ``median_high`` (the 99 % interval)
    of the performance in body lengths; ``path_before`` and ``path_after``, mean search distances up to and after the
    end of the wobble, with half widths; ``trials``, and how many ``diverged``, were ``refined`` and were ``limited``;
    ``diverged_runs``, runs with a trial that diverged. Everything else of an excluded run still counts.
    """
    return described(results.runs(*SUMMARIZED))


def described(runs: pd.DataFrame) -> pd.DataFrame:
    """As `describe`, of the rows of runs with the columns `SUMMARIZED`."""
    rows = [{"condition": str(name)} | _row(mine) for name, mine in runs.groupby("condition", observed=True)]
    return pd.DataFrame(rows)


def summary(results: Results) -> pd.DataFrame:
    """One row a condition: the columns of `describe`, and the difference from the `baseline`.

    ``difference``: performance minus that of the baseline with the same seed, its mean over the ``pairs``, with half
    width.
    """
    runs = results.runs(*SUMMARIZED)
    performance = runs.pivot(index="seed", columns="condition", values="performance")
    reference = baseline(results.conditions)
    differences = performance.sub(performance[reference], axis="index")
    differences[reference] = np.nan
    found = mean_of(differences)
    compared = {"difference": found.mean, "difference_half_width": found.half_width, "pairs": found.n}
    return described(runs).join(pd.DataFrame(compared, index=list(differences.columns)), on="condition")


def _row(runs: pd.DataFrame) -> dict[str, float]:
    performance = runs["performance"].to_numpy()
    score, median = mean_of(performance), median_of(performance)
    return {
        "runs": len(runs),
        "excluded": int(np.isnan(performance).sum()),
        "mean": float(score.mean),
        "half_width": float(score.half_width),
        "median": median.median,
        "median_low": median.low,
        "median_high": median.high,
        **_named("path_before", runs["path_before"].to_numpy()),
        **_named("path_after", runs["path_after"].to_numpy()),
        **{name: int(runs[name].sum()) for name in ("trials", "diverged", "refined", "limited")},
        "diverged_runs": int((runs["diverged"] > 0).sum()),
    }


def _named(name: str, values: NDArray[np.float64]) -> dict[str, float]:
    found = mean_of(values)
    return {name: float(found.mean), f"{name}_half_width": float(found.half_width)}
