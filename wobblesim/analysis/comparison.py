"""Conditions against a baseline, run by run of the same seed: tests, effects and their correction for the family."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from wobblesim.analysis import statistics
from wobblesim.analysis.statistics import SUMMARIZED, described, holm, mean_of, median_of, rank_biserial
from wobblesim.analysis.tables import MOST_NAMES, Results

ALPHA = 0.01
"""Threshold of significance: the paper's (Benureau & Tani 2022, figure 3)."""

MOST_NORMAL = 5000
"""Differences up to which the p-value of the Shapiro-Wilk test is known (Royston 1995)."""

SAME = 1e-12
"""Differences that differ by this share of their size are one number and its rounding."""

REAL = "float64"
PAIRS = {
    "condition": "str",
    "n_pairs": "int64",
    "missing": "int64",
    **dict.fromkeys(("difference", "difference_half_width"), REAL),
    **dict.fromkeys(("median_difference", "median_difference_low", "median_difference_high"), REAL),
    **dict.fromkeys(("effect", "effect_low", "effect_high"), REAL),
    **dict.fromkeys(("shapiro_w", "shapiro_p"), REAL),
    "normal": "bool",
    **dict.fromkeys(("wilcoxon", "p", "p_holm"), REAL),
    "significant": "bool",
    **dict.fromkeys(("t", "t_p"), REAL),
}
"""Columns of `Comparison.pairs` and their types, which are the same where there is no row."""


@dataclass(frozen=True)
class Comparison:
    """Conditions against a baseline; made by `compare`.

    Attributes
    ----------
    conditions : DataFrame
        One row a condition, the baseline among them, as of `statistics.describe`.
    pairs : DataFrame
        One row a condition that is compared: ``condition``; ``n_pairs``, seeds with a score on both sides, and how many
        seeds are ``missing``; ``difference`` from the baseline in body lengths, its mean with ``difference_half_width``
        (99 %), and ``median_difference`` with its interval; ``effect``, the rank-biserial correlation, with its
        interval; ``shapiro_w`` and ``shapiro_p`` of the differences, and whether they may be ``normal`` (p not below
        alpha); ``wilcoxon``, the smaller sum of signed ranks, its ``p``, ``p_holm`` over all rows, and whether that is
        below alpha: ``significant``; ``t`` and ``t_p`` of the paired t test, NaN where the differences are not normal.
    missing : DataFrame
        One row a seed that makes no pair: ``condition``, ``seed``, ``why``.
    baseline : str
    alpha : float
    notes : tuple of str
        What the numbers do not say by themselves: seeds that make no pair, tests that could not be made or won.
    """

    conditions: pd.DataFrame
    pairs: pd.DataFrame
    missing: pd.DataFrame
    baseline: str
    alpha: float
    notes: tuple[str, ...]


def compare(
    results: Results, baseline: str | None = None, alpha: float = ALPHA, conditions: Sequence[str] | None = None
) -> Comparison:
    """Compare the final performance of conditions with that of a baseline, paired by seed.

    Runs of the same seed begin with the same behaviours in every condition, so that a pair differs in the condition
    only.

    Parameters
    ----------
    results : Results
    baseline : str, optional
        Without it, ``fixed`` if there is such a condition, else the first.
    alpha : float
        Threshold of significance, of the Shapiro-Wilk test and of Wilcoxon's test after Holm's correction.
    conditions : sequence of str, optional
        What to compare with the baseline; without it, all others. They are the family that the correction is made for.

    Raises
    ------
    StoreError
        If a condition has no run.
    ValueError
        If alpha is not between 0 and 1.
    """
    if not 0.0 < alpha < 1.0:
        raise ValueError(f"compare: alpha must be between 0 and 1, got {alpha}")
    reference = statistics.baseline(results.conditions) if baseline is None else baseline
    for name in (reference, *(conditions or ())):
        results.require(name)
    chosen = [name for name in results.conditions if conditions is None or name in {reference, *conditions}]
    runs = results.runs(*SUMMARIZED)
    runs = runs[runs["condition"].isin(chosen)]
    others = [name for name in chosen if name != reference]
    missing = _missing(results, runs, reference, others)
    pairs = _pairs(runs, missing, reference, others, alpha)
    notes = (*_notes_of_missing(missing, pairs), *_notes_of_tests(pairs, alpha))
    if conditions is None:
        notes = (*_notes_of_absent(results), *notes)
    return Comparison(described(runs), pairs, missing, reference, alpha, notes)


def _pairs(
    runs: pd.DataFrame, missing: pd.DataFrame, reference: str, others: Sequence[str], alpha: float
) -> pd.DataFrame:
    performance = runs.pivot(index="seed", columns="condition", values="performance")
    lost = missing["condition"].value_counts()
    rows = []
    for name in others:
        found = paired((performance[name] - performance[reference]).to_numpy(), alpha)
        rows.append({"condition": name, "missing": int(lost.get(name, 0)), **found})
    frame = pd.DataFrame(rows, columns=list(PAIRS))
    frame["p_holm"] = holm(frame["p"].to_numpy(dtype=np.float64))
    frame["significant"] = frame["p_holm"] < alpha
    return frame.astype(PAIRS)


def paired(differences: ArrayLike, alpha: float = ALPHA) -> dict[str, Any]:
    """Tests and effect of paired differences, as in a row of `Comparison.pairs`.

    Parameters
    ----------
    differences : (n,)
        A NaN is left out.
    alpha : float
        The t test is made if the Shapiro-Wilk test has no smaller p.
    """
    differences = np.asarray(differences, dtype=np.float64)
    differences = differences[np.isfinite(differences)]
    mean, median, effect = mean_of(differences), median_of(differences), rank_biserial(differences)
    w, w_p = _shapiro(differences)
    statistic, p = _wilcoxon(differences)
    normal = bool(w_p >= alpha)
    t, t_p = _t(differences) if normal else (np.nan, np.nan)
    return {
        "n_pairs": len(differences),
        "difference": float(mean.mean),
        "difference_half_width": float(mean.half_width),
        "median_difference": median.median,
        "median_difference_low": median.low,
        "median_difference_high": median.high,
        "effect": effect.effect,
        "effect_low": effect.low,
        "effect_high": effect.high,
        "shapiro_w": w,
        "shapiro_p": w_p,
        "normal": normal,
        "wilcoxon": statistic,
        "p": p,
        "t": t,
        "t_p": t_p,
    }


def _shapiro(differences: NDArray[np.float64]) -> tuple[float, float]:
    """W and p; NaN for fewer than 3 values, for more than its p is known of, and if all are the same."""
    from scipy.stats import shapiro

    if not 3 <= len(differences) <= MOST_NORMAL or np.ptp(differences) <= SAME * np.abs(differences).max():
        return np.nan, np.nan
    found = shapiro(differences)
    return float(found.statistic), float(found.pvalue)


def _wilcoxon(differences: NDArray[np.float64]) -> tuple[float, float]:
    """The smaller sum of signed ranks and the two-sided p; zeros are left out, and nothing but zeros is no evidence.

    The p is exact for up to 50 differences without ties, and for up to 13 with ties; beyond, it is that of the normal
    distribution, corrected for ties.
    """
    from scipy.stats import wilcoxon

    if not len(differences):
        return np.nan, np.nan
    differences = differences[differences != 0.0]
    if not len(differences):
        return 0.0, 1.0
    found = wilcoxon(differences)
    return float(found.statistic), float(found.pvalue)


def _t(differences: NDArray[np.float64]) -> tuple[float, float]:
    """Student's t of paired values, and the two-sided p."""
    from scipy.stats import ttest_1samp

    found = ttest_1samp(differences, 0.0)
    return float(found.statistic), float(found.pvalue)


# --- what is missing -----------------------------------------------------------------------------------------------


def _missing(results: Results, runs: pd.DataFrame, reference: str, others: Sequence[str]) -> pd.DataFrame:
    """Seeds, asked for or there on either side, that make no pair."""
    scored = dict(zip(zip(runs["condition"], runs["seed"], strict=True), runs["performance"].notna(), strict=True))
    wanted = results.manifest.wanted()
    rows = [
        (name, seed, why)
        for name in others
        for seed in sorted(wanted[name] | wanted[reference])
        if (why := " and ".join(filter(None, (_fault(scored, side, seed) for side in (reference, name)))))
    ]
    return pd.DataFrame(rows, columns=["condition", "seed", "why"])


def _fault(scored: dict[tuple[str, int], bool], condition: str, seed: int) -> str | None:
    if (condition, seed) not in scored:
        return f"no run of {condition}"
    return None if scored[condition, seed] else f"no score in {condition}"


def _notes_of_missing(missing: pd.DataFrame, pairs: pd.DataFrame) -> list[str]:
    """One line a condition that lacks pairs: which seeds, and why."""
    counts = pairs.set_index("condition")["n_pairs"]
    notes = []
    for name, mine in missing.groupby("condition", sort=False):
        reasons = [f"{ranges(seeds)} ({why})" for why, seeds in mine.groupby("why", sort=False)["seed"]]
        of = len(mine) + counts[name]
        notes.append(f"{name}: {len(mine):,} of {of:,} seeds make no pair: {', '.join(reasons)}")
    return notes


def ranges(numbers: Sequence[int] | pd.Series) -> str:
    """Increasing whole numbers in words: ``0..4, 7, 9``."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return ", ".join(f"{part[0]}..{part[-1]}" if len(part) > 2 else ", ".join(map(str, part)) for part in parts)


def _notes_of_absent(results: Results) -> list[str]:
    absent = [name for name in results.manifest.conditions if name not in results.conditions]
    return [f"no finished run yet: {', '.join(absent)}"] if absent else []


def _notes_of_tests(pairs: pd.DataFrame, alpha: float) -> list[str]:
    """One line a reason why tests were not made, or could not have been significant."""
    n, family = pairs["n_pairs"], int(pairs["p"].notna().sum())
    least = 2.0 ** (1 - n.where(n > 0))  # p if all differences have one sign
    least = np.maximum(least, least.min() * family)  # the correction of the smallest p bounds all others
    why = {
        "no pair, so that nothing is tested": n == 0,
        f"too few pairs for p below {alpha:g} after correction, whatever the differences": least >= alpha,
        "all differences are zero": (n > 0) & pairs["effect"].isna(),
        f"more than {MOST_NORMAL:,} pairs, so that their distribution is not tested": n > MOST_NORMAL,
    }
    return [f"{_named(pairs['condition'], where)}: {text}" for text, where in why.items() if where.any()]


def _named(names: pd.Series, where: pd.Series) -> str:
    """Some of the conditions, in words."""
    chosen = list(names[where])
    if len(chosen) == len(names) > 2:
        return f"all {len(names):,} comparisons"
    others = f" and {len(chosen) - MOST_NAMES:,} more" if len(chosen) > MOST_NAMES else ""
    return ", ".join(chosen[:MOST_NAMES]) + others
