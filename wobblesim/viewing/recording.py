"""A stored behaviour, simulated again and recorded: what a player or a film shows.

No trajectory is stored. A trial has the same bits every time, so the behaviour, the robot of its epoch and the settings
of its condition are enough, and the performance found tells whether it is the trial that was stored.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wobblesim.analysis.tables import Results
from wobblesim.learning.run import Setup
from wobblesim.learning.search import ranking, score
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.robot.body import Body
from wobblesim.robot.morphology import Morphology
from wobblesim.study.errors import StoreError
from wobblesim.study.group import written_seeds
from wobblesim.study.plan import steps
from wobblesim.study.rerun import StoredRun, read_run

Floats = NDArray[np.float64]

FRAMES_PER_SECOND = 30.0
"""Wanted of a recording; the nearest whole number of steps decides: 25 with the default step of 0.02 s."""

LONGEST = 600.0
"""s of a trial that are shown if not told otherwise: who looks at more, looks at parts of it."""

MOST_NUMBERS = 5_000_000
"""Coordinates of a recording at most, about as many bytes of a page; frames of larger robots are further apart."""

FARTHEST = 10_000.0
"""Of the robot's extent: beyond that, only a motion that is about to diverge brings a node."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One trial as it was seen; made by `record`.

    Attributes
    ----------
    condition : str
    seed, epoch : int
    behaviour : (2 n_groups,)
        Amplitudes, then offsets in turns.
    morphology : Morphology
        Factors of the epoch on the adult.
    body : Body
        As built with these factors: its springs, which of them are muscles, and their lengths at rest.
    floor : float or None
        Height of the floor, u; None in free flight.
    duration : float
        Of the trial, s.
    times : (n_frames,)
        s; the first is 0. Frames are equally far apart but for the last, which is the end of what is shown.
    positions : (n_frames, n_nodes, 2)
        u.
    performance : float
        As computed now, body lengths of the adult; NaN if the trial diverged.
    stored : float
        As the results have it.
    status : str
        See `Trials`.
    dt : float
        Step of the trial that is shown, s.
    bound : str
        The trusted bound that the trial left at first; empty if none.
    diverged_at : float
        s; NaN if it did not.
    """

    condition: str
    seed: int
    epoch: int
    behaviour: Floats = field(repr=False)
    morphology: Morphology
    body: Body = field(repr=False)
    floor: float | None
    duration: float
    times: Floats = field(repr=False)
    positions: Floats = field(repr=False)
    performance: float
    stored: float
    status: str
    dt: float
    bound: str
    diverged_at: float

    @property
    def run(self) -> str:
        """Seed and epoch in words."""
        return f"seed {self.seed}, epoch {self.epoch}"

    @property
    def distance(self) -> Floats:
        """Of the centre's nodes from their start along +x (n_frames,), body lengths of the adult."""
        place = self.positions[:, self.body.center, 0].mean(axis=1)
        return (place - place[0]) / self.body.body_length

    @property
    def contraction(self) -> Floats:
        """By how much of its length at rest each muscle is shorter, (n_frames, n_muscles); negative if it is longer."""
        ends = self.positions[:, self.body.springs[self.body.muscle_spring]]
        length = np.hypot(*np.moveaxis(ends[:, :, 1] - ends[:, :, 0], -1, 0))
        return 1.0 - length / self.body.rest_length[self.body.muscle_spring]

    @property
    def is_the_stored_trial(self) -> bool:
        """Whether the performance has the bits of the stored one."""
        return self.performance == self.stored or (math.isnan(self.performance) and math.isnan(self.stored))

    @property
    def notes(self) -> list[str]:
        """What one has to know of the trial, a sentence each; none of most trials."""
        return [*self._note_of_the_end(), *self._note_of_the_step(), *self._note_of_the_bits()]

    def _note_of_the_end(self) -> list[str]:
        end, wanted = f"{self.times[-1]:g} s", f"{self.duration:g} s"
        if self.status == "diverged":
            return [
                f"This trial diverged: it left the trusted bounds ({self.bound}) and was stopped at "
                f"{self.diverged_at:g} s. The recording ends at {end}."
            ]
        # The last step of a trial may end a little before or after the duration asked for.
        return [f"The first {end} of a trial of {wanted}."] if self.duration - self.times[-1] > self.dt else []

    def _note_of_the_step(self) -> list[str]:
        if self.status != "refined":
            return []
        return [f"It left the trusted bounds ({self.bound}) at first: this is the run with a step of {self.dt:g} s."]

    def _note_of_the_bits(self) -> list[str]:
        if self.is_the_stored_trial:
            return []
        return [
            f"This is not quite the stored trial, which another version or processor has computed: it comes to "
            f"{_in_words(self.performance)}, stored is {_in_words(self.stored)}{self._difference()}."
        ]

    def _difference(self) -> str:
        difference = self.performance - self.stored
        return f", a difference of {difference:.2g}" if math.isfinite(difference) else ""


def _in_words(performance: float) -> str:
    return f"{performance:.6g} body lengths" if math.isfinite(performance) else "no score (diverged)"


def record(
    results: Results,
    condition: str,
    seed: int,
    epoch: int | None = None,
    *,
    frames_per_second: float = FRAMES_PER_SECOND,
    seconds: float | None = None,
) -> Recording:
    """Simulate the best behaviour of an epoch again, and record it.

    Parameters
    ----------
    results : Results
    condition : str
        Its id.
    seed : int
    epoch : int, optional
        The last if not given. Other epochs are known of runs with ``log: behaviours``.
    frames_per_second : float
        Frames are the nearest whole number of steps apart.
    seconds : float, optional
        How much of the trial is shown, from its start; at most `LONGEST` if not given.

    Raises
    ------
    StoreError
        If there is no such run or epoch, nothing is known of its behaviours, or it cannot be simulated here.
    ValueError
        If the frames or seconds are not above 0.
    """
    _check_above_0(frames_per_second=frames_per_second, seconds=seconds)
    run = _run_of(results, condition, seed)
    try:
        setup = run.setup
        tried = _tried(results, run, epoch)
        seen = _watch(setup, tried, frames_per_second, LONGEST if seconds is None else seconds)
    except ValueError as error:
        raise StoreError(
            f"{_name(condition, seed)} of {results.folder} cannot be simulated here: {error}; "
            "use the version that has computed it"
        ) from error
    morphology = setup.morphology(tried.epoch)
    return Recording(
        condition=condition,
        seed=seed,
        epoch=tried.epoch,
        behaviour=tried.behaviour,
        morphology=morphology,
        body=setup.body.adapted(morphology),
        floor=0.0 if setup.scene.floor else None,
        duration=setup.duration,
        times=seen.times,
        positions=seen.positions,
        performance=float(score(seen.trial.displacement, setup.search.direction)[0]),
        stored=tried.performance,
        status=str(seen.trial.status[0]),
        dt=float(seen.trial.dt[0]),
        bound=str(seen.trial.bound[0]),
        diverged_at=float(seen.trial.diverged_at[0]),
    )


def _check_above_0(**numbers: float | None) -> None:
    for name, number in numbers.items():
        if number is not None and not 0 < number < math.inf:
            raise ValueError(f"{name} is {number}: it must be finite and above 0")


# --- which behaviour -----------------------------------------------------------------------------------------------


class _Tried(NamedTuple):
    """A stored trial."""

    epoch: int
    behaviour: Floats
    performance: float


def _name(condition: str, seed: int) -> str:
    return f"{condition}, seed {seed}"


def _run_of(results: Results, condition: str, seed: int) -> StoredRun:
    """The run's row, with all of its settings."""
    key = condition, seed
    if key in results.manifest.failures:
        why = results.manifest.failures[key].strip().rpartition("\n")[-1]
        raise StoreError(
            f"{_name(*key)} of {results.folder} came to no result ({why}); give the sweep command again, "
            "or choose another seed"
        )
    check_condition(results, condition)
    if key not in results.manifest.runs:
        seeds = sorted(seed for name, seed in results.manifest.runs if name == condition)
        raise StoreError(f"{results.folder} has no seed {seed} of {condition}; choose among {written_seeds(seeds)}")
    return _read(results, "runs", condition, seed)


def check_condition(results: Results, condition: str) -> None:
    """Refuse a condition that is not there, and name the nearest that is.

    Raises
    ------
    StoreError
        If it is not there.
    """
    if condition in results.conditions:
        return
    near = difflib.get_close_matches(condition, results.conditions, 1, cutoff=0.5)
    meant = f" (did you mean '{near[0]}'?)" if near else ""
    known = ", ".join(results.conditions[:MOST_NAMED]) + (", ..." if len(results.conditions) > MOST_NAMED else "")
    raise StoreError(f"{results.folder} has no condition '{condition}'{meant}; choose among {known}")


MOST_NAMED = 8
"""Conditions that are listed in a sentence."""


def _read(results: Results, table: str, condition: str, seed: int) -> StoredRun:
    return read_run(results.folder / results.manifest.runs[condition, seed].files[table].path, seed)


def _tried(results: Results, run: StoredRun, epoch: int | None) -> _Tried:
    """The best trial of an epoch."""
    last = run.parameters.learning.epochs - 1
    if epoch is not None and not 0 <= epoch <= last:
        raise StoreError(
            f"{_name(run.condition, run.seed)} of {results.folder} has no epoch {epoch}; choose one from 0 to {last}"
        )
    if epoch in (None, last) and "genotype" in run.rows.column_names:
        return _last(results, run, last, chosen=epoch is not None)
    return _best_of(results, run, last if epoch is None else epoch)


def _last(results: Results, run: StoredRun, epoch: int, chosen: bool) -> _Tried:
    """The best trial of the last epoch; one without a score has to be asked for by its epoch."""
    row = run.rows.to_pylist()[0]
    if row["status"] == "failed" and not chosen:
        raise StoreError(
            f"{_name(run.condition, run.seed)} of {results.folder} has no score, because all trials of its last epoch "
            f"diverged; choose another seed, or watch the failure with --epoch {epoch}"
        )
    return _Tried(epoch, np.array(row["genotype"]), _number(row["performance"]))


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _best_of(results: Results, run: StoredRun, epoch: int) -> _Tried:
    """The best trial of an epoch, from the tables of all trials."""
    key = run.condition, run.seed
    if "behaviours" not in results.manifest.runs[key].files:
        stored = "but for the last epoch's best" if "genotype" in run.rows.column_names else "by an older version"
        raise StoreError(
            f"the behaviours of {_name(*key)} were not stored, {stored}; set `log: behaviours` in the configuration "
            "and run it into another folder"
        )
    population = run.parameters.learning.population
    scores, behaviours = (
        _read(results, table, *key).rows[column].slice(epoch * population, population)
        for table, column in (("trials", "performance"), ("behaviours", "genotype"))
    )
    performance = np.array(scores.to_pylist(), dtype=np.float64)
    best = ranking(performance)[0]
    return _Tried(epoch, np.array(behaviours[int(best)].as_py()), float(performance[best]))


# --- what it does --------------------------------------------------------------------------------------------------


class _Seen(NamedTuple):
    """A trial, and the part of it that is shown."""

    trial: Trials
    times: Floats
    positions: Floats


def _watch(setup: Setup, tried: _Tried, frames_per_second: float, seconds: float) -> _Seen:
    """Run the whole trial for its outcome, then what is shown of it, frame by frame.

    A trial that left the trusted bounds was run with a smaller step: so is what is shown, also if that ends before the
    bounds were left.
    """
    n_steps, dt = steps(setup), setup.physics.dt
    how: dict[str, Any] = {"morphology": setup.morphology(tried.epoch), "scene": setup.scene, "gait": setup.gait}
    trial = simulate(
        setup.body, [tried.behaviour], physics=setup.physics, duration=n_steps * dt, record_every=n_steps, **how
    )
    shown = min(n_steps, max(1, round(seconds / dt)))
    every = _steps_a_frame(setup, shown, frames_per_second)
    positions = _frames(setup, tried.behaviour, shown, every, float(trial.dt[0]), how)
    times = np.arange(len(positions), dtype=np.float64) * (every * dt)
    if shown == n_steps and n_steps % every:
        assert trial.positions is not None
        positions = np.concatenate([positions, trial.positions[-1:, :, :, 0].astype(np.float64)])
        times = np.append(times, n_steps * dt)
    return _Seen(trial, *_until_lost(setup.body, times, positions))


def _steps_a_frame(setup: Setup, shown: int, frames_per_second: float) -> int:
    wanted = round(1.0 / (frames_per_second * setup.physics.dt))
    least = math.ceil(shown * 2 * setup.body.n_nodes / MOST_NUMBERS)
    return min(shown, max(1, wanted, least))


def _frames(setup: Setup, behaviour: Floats, shown: int, every: int, dt: float, how: Mapping[str, Any]) -> Floats:
    """Positions of every so many steps of the setup, computed with steps of `dt`, which is a whole part of them."""
    parts = round(setup.physics.dt / dt)
    physics = replace(setup.physics, dt=dt, refinements=0)
    seen = simulate(
        setup.body, [behaviour], physics=physics, duration=shown * parts * dt, record_every=every * parts, **how
    )
    assert seen.positions is not None
    return seen.positions[..., 0].astype(np.float64)


def _until_lost(body: Body, times: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """The frames before the first that holds something which is not a number, or is out of all bounds."""
    reach = FARTHEST * extent(body)
    lost = np.flatnonzero(~(np.abs(positions).max(axis=(1, 2)) <= reach))  # not so: also of a NaN
    n = max(1, int(lost[0])) if len(lost) else len(times)
    return times[:n], positions[:n]


def extent(body: Body) -> float:
    """Larger side of the box around a body as built, u; its body length if that is 0."""
    return float(np.ptp(body.position, axis=0).max()) or body.body_length
