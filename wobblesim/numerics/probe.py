"""What a sweep will take, foreseen from a timed probe of one or two seconds: time, memory and disk.

Of the kinds of conditions that differ in their kernels or bodies, a few are timed, those with the most work first; the
others are taken to be as fast as the one most like them. Everything else follows from counting epochs and steps, so
that ten thousand conditions are foreseen as soon as one.
"""

from __future__ import annotations

import statistics
import time
from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from wobblesim.learning.run import Setup
from wobblesim.numerics.explain import Books, keep_books, resident, trial_bytes
from wobblesim.physics.kernels import available_threads
from wobblesim.physics.simulate import call_cost, full_block, simulate
from wobblesim.robot.morphology import Morphology
from wobblesim.study.plan import Kind, lane_steps, span, steps
from wobblesim.study.preview import Preview
from wobblesim.study.work import WRITERS

MOST_KERNELS, MOST_LEARNERS = 6, 3
"""Kinds that are timed, at most: there are six pairs of integrator and precision, and three logs."""

PATIENCE = 0.8  # s for timing kernels, in all
LEARNING = 0.15  # s for timing the learner of a kind
SHORT = 20  # steps of the call that tells what a call costs besides its steps

Found = TypeVar("Found")


@dataclass(frozen=True)
class Forecast:
    """What the missing runs take.

    Attributes
    ----------
    core_seconds : dict of str to float
        By condition: time of its groups times the threads of each, s.
    seconds : float
        Wall time, s.
    results, checkpoints : int
        Bytes on the disk: the results, and what lies there besides while groups are in work, at most.
    memory : int
        Bytes, of all processes together.
    kinds, timed : int
        Kinds of kernels and bodies among the conditions, and how many of them were timed.
    """

    core_seconds: dict[str, float]
    seconds: float
    results: int
    checkpoints: int
    memory: int
    kinds: int
    timed: int


def forecast(seen: Preview, stored: Callable[[str], Mapping[str, Any]], workers: int = 1, threads: int = 1) -> Forecast:
    """Foresee what a sweep takes on cores like those of this machine, as busy as it is now.

    Parameters
    ----------
    seen : Preview
        Made for the same workers and threads.
    stored : callable
        Settings of a condition, of this id, as columns of the table of runs.
    workers, threads : int
        How many groups are computed at a time, and with how many threads each.
    """
    groups = list(seen.groups())
    if not groups:
        return Forecast({}, 0.0, 0, 0, resident(), 0, 0)
    setups, size = seen.study.setups, max(seeds for _, seeds, _, _ in groups)
    speeds = _speeds(seen, groups, size, workers, threads)
    books = _books(seen, groups, size, stored)
    times: Counter[float] = Counter()
    core_seconds = dict.fromkeys((condition for condition, _, _, _ in groups), 0.0)
    results = logged = tables = 0.0
    for condition, seeds, epoch, alike in groups:
        setup, mine = setups[condition], books.of(condition)
        left = lane_steps(setup, epoch) / lane_steps(setup)
        epochs = (setup.epochs - epoch) * mine.epoch * seeds / size
        taken = left * speeds.of(condition).group(setup, seeds, threads) + epochs + seeds * mine.commit
        times[taken] += alike
        core_seconds[condition] += alike * taken * threads
        results += alike * seeds * mine.bytes_of(setup.epochs)
        of_run = setup.epochs * mine.logged
        logged = max(logged, seeds * of_run)
        # its columns are there twice at the end of a group, as parts and put together, and again of runs being written
        tables = max(tables, 2 * (seeds + min(seeds, WRITERS)) * of_run)
    trials = max(trial_bytes(setups[name], size * setups[name].search.population, threads) for name in speeds.timed)
    processes = 1 if workers == 1 else workers + 1
    return Forecast(
        core_seconds,
        seconds=span(times, workers),
        results=round(results),
        checkpoints=round(workers * logged),
        memory=processes * resident() + workers * (trials + round(tables)),
        kinds=speeds.kinds,
        timed=len(speeds.timed),
    )


Groups = Sequence[tuple[str, int, int, int]]
"""As `Preview.groups` gives them."""


class _Probed(Generic[Found]):
    """What was found for a few conditions, and stands for all.

    Parameters
    ----------
    keys : mapping
        Of each condition, what the finding depends on; the first entry tells conditions apart that have little in
        common.
    work : mapping
        Of each condition, how much there is to do.
    most : int
        How many different keys to probe, at most: first one for each first entry, those with more work before others.
    probe : callable
        Finds it for a condition.
    """

    def __init__(
        self,
        keys: Mapping[str, tuple[Hashable, ...]],
        work: Mapping[str, int],
        most: int,
        probe: Callable[[str, int], Found],
    ) -> None:
        self._keys = keys
        of_key: Counter[tuple[Hashable, ...]] = Counter()
        example: dict[tuple[Hashable, ...], str] = {}
        for condition, key in keys.items():
            of_key[key] += work[condition]
            example.setdefault(key, condition)
        by_work = sorted(of_key, key=lambda key: -of_key[key])
        first = {key[0]: key for key in reversed(by_work)}
        chosen = sorted(by_work, key=lambda key: first[key[0]] != key)[:most]
        self.kinds, self.timed = len(of_key), [example[key] for key in chosen]
        self._found = {key: probe(example[key], len(chosen)) for key in chosen}
        self._like = {key[0]: found for key, found in reversed(self._found.items())}
        self._any = self._found[chosen[0]]

    def of(self, condition: str) -> Found:
        """What was found for a condition, or for the one most like it."""
        key = self._keys[condition]
        return self._found.get(key) or self._like.get(key[0]) or self._any


# --- kernels -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Speed:
    """How fast a kind of condition is simulated.

    Attributes
    ----------
    call : float
        Time of a call of `simulate` for another morphology than before, besides its steps, s.
    step : float
        Time of a step of a full block of lanes on each thread while all cores are at work, s.
    """

    call: float
    step: float

    def group(self, setup: Setup, seeds: int, threads: int) -> float:
        """Time of all trials of a group, s."""
        return self.step * Kind.of(setup).cost(seeds, threads, call=self.call / self.step)


def _speeds(seen: Preview, groups: Groups, size: int, workers: int, threads: int) -> _Probed[Speed]:
    setups, work = seen.study.setups, Counter[str]()
    for condition, seeds, epoch, alike in groups:
        work[condition] += alike * seeds * lane_steps(setups[condition], epoch)
    keys = {name: _kernel(setups[name]) for name in work}

    def probe(name: str, of: int) -> Speed:
        return speed(setups[name], size, workers, threads, PATIENCE / of)

    return _Probed(keys, work, MOST_KERNELS, probe)


def _kernel(setup: Setup) -> tuple[Hashable, ...]:
    """What the time of a step depends on."""
    physics = setup.physics
    return (physics.integrator, physics.precision), setup.body, setup.scene, physics


def speed(setup: Setup, seeds: int, workers: int, threads: int, patience: float) -> Speed:
    """Time calls of `simulate` as a group of runs makes them, about as long as `patience`, s."""
    cores = min(workers * threads, available_threads())
    tried, full = seeds * setup.search.population, full_block(setup.physics)
    busy = max(1, tried * cores // threads)  # trials that keep all cores at work as the sweep does
    short = min(SHORT, steps(setup))
    _call(setup, busy, cores, short)  # compiles the kernel, or fetches it
    base = min(_call(setup, busy, cores, short) for _ in range(3))
    some = _call(setup, busy, cores, 6 * short)
    longer = max(6 * short, int(patience / 4 * 6 * short / some))
    taken = statistics.median(_call(setup, busy, cores, longer) for _ in range(3))
    step = max(taken - base, 1e-9) / (longer - short) / call_cost(busy, cores, full)
    alone = min(_call(setup, tried, threads, short, changed=1 + (1 + number) * 1e-9) for number in range(3))
    return Speed(max(alone - short * step * call_cost(tried, threads, full), 0.0), step)


def _call(setup: Setup, n_trials: int, threads: int, n_steps: int, changed: float = 1.0) -> float:
    """Wall time of a call of `simulate`, s; a factor on the mass other than before makes it another robot."""
    behaviours = np.random.default_rng(0).random((n_trials, 2 * setup.body.n_groups))
    begun = time.perf_counter()
    simulate(
        setup.body, behaviours, morphology=Morphology(mass=changed), scene=setup.scene, physics=setup.physics,
        gait=setup.gait, duration=n_steps * setup.physics.dt, threads=threads,
    )  # fmt: skip
    return time.perf_counter() - begun


# --- learner, log and store ----------------------------------------------------------------------------------------


def _books(seen: Preview, groups: Groups, size: int, stored: Callable[[str], Mapping[str, Any]]) -> _Probed[Books]:
    study, work = seen.study, Counter[str]()
    for condition, seeds, epoch, alike in groups:
        work[condition] += alike * seeds * (study.setups[condition].epochs - epoch)
    keys = {}
    for name in work:
        setup = study.setups[name]
        keys[name] = study.conditions[name].log, setup.search, setup.body.n_groups, setup.wobble is None

    def probe(name: str, _: int) -> Books:
        return keep_books(study, name, stored(name), size, LEARNING)

    return _Probed(keys, work, MOST_LEARNERS, probe)
