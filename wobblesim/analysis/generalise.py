"""How a learnt gait does on other robots: the last best behaviour of each run, tried over a range of morphologies.

The paper asks how well a robot learns while its body changes. This asks what the gait is worth when the body changes
after learning: on a heavier robot, a stiffer one, a larger one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.tables import Results
from wobblesim.learning.run import Setup
from wobblesim.learning.search import score
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology
from wobblesim.study.rerun import read_run

Floats = NDArray[np.float64]

FACTORS = 19
"""Factors of a range, its ends and the adult's 1 among them."""

COLUMNS = ("condition", "seed", "dimension", "factor", "performance", "status", "stored")


def generalise(
    results: Results,
    conditions: Sequence[str] | None = None,
    factors: Sequence[float] | None = None,
    seeds: Sequence[int] | None = None,
    duration: float | None = None,
    most: int | None = None,
    threads: int | None = None,
    *,
    simulate: Callable[..., Trials] = simulate,
) -> pd.DataFrame:
    """Try the last best behaviour of each run on robots of other masses, stiffnesses, sizes or gravities.

    A run is tried in the dimension in which its condition wobbles; one of a fixed robot in all that wobble in the
    study. Runs without a score have learnt no gait and are left out.

    The cost is one trial for each run and factor, all runs of the same robot in one call. On one core, a million steps
    of the paper's robot take a second: 100 runs, 19 factors and trials of 3000 steps (60 s) take 6 s.

    Parameters
    ----------
    results : Results
    conditions : sequence of str, optional
        Whose runs are tried; all if not given.
    factors : sequence of float, optional
        On the adult's value, the same in every dimension. If not given, `factors_of` the range that the wobbles of the
        study span in a dimension.
    seeds : sequence of int, optional
        Of the runs that are tried; all if not given.
    duration : float, optional
        Of a trial, s; as in the study if not given.
    most : int, optional
        Runs of a condition, those of the least seeds; no bound if not given.
    threads : int, optional
        As for `simulate`; the bits do not depend on it.
    simulate : callable
        Called as `wobblesim.simulate` is.

    Returns
    -------
    DataFrame
        A row for each ``condition``, ``seed``, ``dimension`` (two that wobble together: ``mass+size``) and ``factor``;
        ``performance`` in body lengths of the adult, NaN if the trial diverged; ``status`` as in `Trials`; ``stored``,
        what the results have for this trial: on the robot of the last epoch, that is on the adult if the wobble had
        ended, the performance of the run, which comes out again bit for bit. NaN where they have nothing.

    Raises
    ------
    FigureError
        If no condition wobbles, the results are of a version that kept no last behaviour, or a robot cannot be
        simulated with the study's time step.
    StoreError
        If a condition is not there.
    ValueError
        If there is no factor, or one or the duration is not above 0.
    """
    _check(factors, duration)
    chosen = results.conditions if conditions is None else list(dict.fromkeys(conditions))
    for condition in chosen:
        results.require(condition)
    runs = last_behaviours(results)
    ranges = spans(runs)
    learnt = runs[runs["condition"].isin(chosen) & runs["performance"].notna()]
    if seeds is not None:
        learnt = learnt[learnt["seed"].isin(seeds)]
    if most is not None:
        learnt = learnt.groupby("condition", observed=True).head(most)
    batches = _batches(results, learnt, list(ranges), duration)
    grids = {
        dimension: factors_of(*ends) if factors is None else np.unique(factors) for dimension, ends in ranges.items()
    }
    rows = [_rows(batch, grids[batch.key.dimension], threads, simulate) for batch in batches]
    return _in_order(rows, results.conditions, list(ranges))


def spans(runs: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """By dimension, the least and the greatest factor that the wobbles of a study reach, the adult's 1 among them.

    Parameters
    ----------
    runs : DataFrame
        Rows of the table ``runs``.

    Raises
    ------
    FigureError
        If none of them wobbles.
    """
    found: dict[str, tuple[float, float]] = {}
    for _, wobble in runs.drop_duplicates("condition").dropna(subset="wobble.dimension").iterrows():
        low, high = found.get(wobble["wobble.dimension"], (1.0, 1.0))
        least, most = span_of(wobble)
        found[wobble["wobble.dimension"]] = min(low, least), max(high, most)
    found = {dimension: ends for dimension, ends in found.items() if ends[0] < ends[1]}
    if not found:
        raise FigureError(
            "this study has no condition that wobbles, so that there is no range to try its gaits on; add one with a "
            "wobble"
        )
    return found


def span_of(run: pd.Series) -> tuple[float, float]:
    """The least and the greatest factor of the sine of a run, a row of the table ``runs``; both 1 for a fixed robot."""
    if pd.isna(run["wobble.dimension"]):
        return 1.0, 1.0
    middle, amplitude, bound = (float(run[f"wobble.{name}"]) for name in ("mean", "amplitude", "upper_bound"))
    least, most = np.fmin([middle - amplitude, middle + amplitude], bound)
    return float(least), float(most)


def factors_of(low: float, high: float, count: int = FACTORS) -> Floats:
    """Factors from `low` to `high`, both of them and 1 exactly, evenly on each side of 1.

    Parameters
    ----------
    low, high : float
        Around 1.
    count : int
    """
    below = round((count - 1) * (1.0 - low) / (high - low))
    below = min(max(below, low < 1.0), count - 1 - (high > 1.0))
    return np.concatenate([np.linspace(low, 1.0, below + 1), np.linspace(1.0, high, count - below)[1:]])


def _check(factors: Sequence[float] | None, duration: float | None) -> None:
    if factors is not None and not len(factors):
        raise ValueError("generalise: there is no factor to try; give at least one")
    for name, numbers in {"factor": factors, "duration": [duration]}.items():
        for number in numbers or ():
            if number is not None and not 0.0 < number < math.inf:
                raise ValueError(f"generalise: a {name} must be finite and above 0, got {number}")


def last_behaviours(results: Results) -> pd.DataFrame:
    """The table ``runs``, of which ``genotype`` is the best behaviour of the last epoch.

    Raises
    ------
    FigureError
        If the results are of a version that did not keep it.
    """
    runs = results.runs()
    if "genotype" not in runs or runs["genotype"].isna().any():
        raise FigureError(
            f"{results.folder} is of an older version, which did not keep the last behaviour of each run; run the "
            "study again into another folder"
        )
    return runs


# --- what is tried together ----------------------------------------------------------------------------------------


class _Key(NamedTuple):
    """All that decides a trial besides the behaviour and the factor."""

    dimension: str
    duration: float
    body: Body
    scene: Scene
    physics: Physics
    gait: Gait
    direction: str

    @classmethod
    def of(cls, setup: Setup, dimension: str, duration: float | None) -> _Key:
        seconds = setup.duration if duration is None else duration
        return cls(dimension, seconds, setup.body, setup.scene, setup.physics, setup.gait, setup.search.direction)


@dataclass(frozen=True, eq=False)
class _Batch:
    """Runs of the same robot, tried in one call for each factor."""

    key: _Key
    runs: pd.DataFrame
    last: Floats  # (n_runs,): factor of the last epoch; NaN if trials had another duration then

    def stored(self, factor: float) -> Floats:
        """Performance of the runs whose last epoch had these trials, NaN of the others (n_runs,)."""
        return np.where(self.last == factor, self.runs["performance"].to_numpy(), np.nan)


def _batches(results: Results, runs: pd.DataFrame, dimensions: Sequence[str], duration: float | None) -> list[_Batch]:
    """Runs by dimension and by all that decides a trial besides the behaviour and the morphology."""
    together: dict[_Key, list[tuple[Setup, pd.DataFrame]]] = {}
    for condition, mine in runs.groupby("condition", observed=True):
        setup = _setup_of(results, str(condition), int(mine["seed"].iloc[0]))
        own = mine["wobble.dimension"].iloc[0]
        for dimension in dimensions:
            if pd.isna(own) or dimension == own:
                together.setdefault(_Key.of(setup, dimension, duration), []).append((setup, mine))
    return [_batch(key, parts) for key, parts in together.items()]


def _setup_of(results: Results, condition: str, seed: int) -> Setup:
    """What a condition simulates, as the file of one of its runs tells."""
    return read_run(results.folder / results.manifest.runs[condition, seed].files["runs"].path, seed).setup


def _batch(key: _Key, parts: Sequence[tuple[Setup, pd.DataFrame]]) -> _Batch:
    last = np.concatenate([np.full(len(runs), _last_factor(setup, key)) for setup, runs in parts])
    return _Batch(key, pd.concat([runs for _, runs in parts]), last)


def _last_factor(setup: Setup, key: _Key) -> float:
    """Factor of the robot of the last epoch: the dimension is the condition's own, or the robot is the adult."""
    if key.duration != setup.duration:
        return math.nan
    return float(getattr(setup.morphology(setup.epochs - 1), key.dimension.partition("+")[0]))


# --- trying it -----------------------------------------------------------------------------------------------------


def _rows(batch: _Batch, factors: Floats, threads: int | None, simulate: Callable[..., Trials]) -> pd.DataFrame:
    return pd.concat(pd.DataFrame(_outcome(batch, float(factor), threads, simulate)) for factor in factors)


def _outcome(batch: _Batch, factor: float, threads: int | None, simulate: Callable[..., Trials]) -> dict[str, Any]:
    key, runs = batch.key, batch.runs
    morphology = Morphology(**dict.fromkeys(key.dimension.split("+"), factor))
    try:
        trials = simulate(
            key.body, np.stack(runs["genotype"].to_list()), morphology=morphology, scene=key.scene,
            physics=key.physics, gait=key.gait, duration=key.duration, threads=threads,
        )  # fmt: skip
    except ValueError as error:
        names = ", ".join(dict.fromkeys(runs["condition"]))
        raise FigureError(
            f"the robot of {names} cannot be simulated with {factor:g} times its {key.dimension}: {error}"
        ) from error
    return {
        "condition": runs["condition"].to_numpy(),
        "seed": runs["seed"].to_numpy(),
        "dimension": key.dimension,
        "factor": factor,
        "performance": score(trials.displacement, key.direction),
        "status": trials.status,
        "stored": batch.stored(factor),
    }


def _in_order(parts: Sequence[pd.DataFrame], conditions: Sequence[str], dimensions: Sequence[str]) -> pd.DataFrame:
    """Rows by dimension, condition, seed and factor."""
    rows = pd.concat(parts) if parts else pd.DataFrame(columns=list(COLUMNS))
    rows["condition"] = pd.Categorical(rows["condition"].astype(str), conditions, ordered=True)
    rows["dimension"] = pd.Categorical(rows["dimension"], dimensions, ordered=True)
    rows = rows.sort_values(["dimension", "condition", "seed", "factor"], ignore_index=True)
    return rows.astype({"dimension": str})[list(COLUMNS)]
