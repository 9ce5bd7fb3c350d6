"""What a sweep asks of this machine: the terms of its scenes, trials, time, memory and disk, measured here and now."""

from __future__ import annotations

import itertools
import json
import math
import resource
import statistics
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wobblesim.learning.run import Learner, Setup
from wobblesim.numerics.explain_terms import Costs, alike, measure, system_and_method
from wobblesim.physics.contract import State, rows
from wobblesim.physics.lanes import lanes
from wobblesim.physics.simulate import Trials, block_widths, full_block, simulate
from wobblesim.study.plan import Kind, Study, group_size, shares, steps
from wobblesim.study.rows import Log, run_tables
from wobblesim.study.store import attempt, opened, stage

PROBE = 0.15  # s: length of a timed call of a whole epoch
SHORT = 20  # steps of the call that tells what a call costs besides its steps
LOGGED = 200  # epochs of the trial run of the learner, at most
PATIENCE = 0.5  # s for that run


@dataclass(frozen=True)
class SceneCosts:
    """Conditions whose scenes have the same kernel and bodies of the same size, and its terms.

    The costs are those of the first condition.
    """

    conditions: tuple[str, ...]
    integrator: str
    precision: str
    costs: Costs


@dataclass(frozen=True)
class Work:
    """What is to be done of a condition.

    Attributes
    ----------
    condition : str
    wanted, present, missing : int
        Runs.
    trials, reused : int
        Of the missing runs; the reused are not simulated.
    lane_steps : int
        Of the missing runs.
    physics, learning : float
        Expected wall time of the missing runs: simulating, and all else, s.
    """

    condition: str
    wanted: int
    present: int
    missing: int
    trials: int
    reused: int
    lane_steps: int
    physics: float
    learning: float

    @property
    def simulated(self) -> int:
        """Trials that are simulated."""
        return self.trials - self.reused


@dataclass(frozen=True)
class Memory:
    """Bytes: the program with its libraries and kernels; blocks of lanes and what is read off; tables of a group."""

    program: int
    trials: int
    tables: int

    @property
    def total(self) -> int:
        """Bytes in all."""
        return self.program + self.trials + self.tables


@dataclass(frozen=True)
class Disk:
    """Bytes: the results of the missing runs; what checkpoints take besides while a group is computed, at most."""

    results: int
    checkpoints: int


@dataclass(frozen=True)
class Explanation:
    """What a sweep leaves out, and what it needs."""

    scenes: tuple[SceneCosts, ...]
    work: tuple[Work, ...]
    memory: Memory
    disk: Disk
    threads: int

    @property
    def seconds(self) -> float:
        """Expected wall time of the missing runs."""
        return sum(work.physics + work.learning for work in self.work)


def explain(
    study: Study,
    present: Mapping[str, int],
    stored: Mapping[str, Mapping[str, Any]],
    threads: int,
    seconds: float,
) -> Explanation:
    """Measure what a sweep's missing runs need.

    Parameters
    ----------
    study : Study
    present : mapping of str to int
        How many runs of each condition are there.
    stored : mapping of str to mapping
        Settings of each condition as columns of the table of runs.
    threads : int
    seconds : float
        About how long to time the terms of the scenes; kernels are compiled, and all else is measured, besides.

    Raises
    ------
    PlanError
        If a condition cannot be run.
    """
    probes = Probes(study, stored, threads)
    missing = {name: len(study.seeds) - present.get(name, 0) for name in study.conditions}
    size = _size(study, missing, threads)
    sizes = {name: shares(count, size) for name, count in missing.items()}
    work = tuple(_work(study, name, present.get(name, 0), sizes[name], probes) for name in study.conditions)
    disk = [_disk(study, name, sizes[name], probes) for name in study.conditions]
    memory = [_memory(study, name, sizes[name], probes, threads) for name in study.conditions]
    return Explanation(
        scenes=_scenes(study, seconds),
        work=work,
        memory=Memory(resident(), *(max(part) for part in zip(*memory, strict=True))),
        disk=Disk(sum(results for results, _ in disk), max(checkpoints for _, checkpoints in disk)),
        threads=threads,
    )


def _size(study: Study, missing: Mapping[str, int], threads: int) -> int:
    """Seeds in a group, at most."""
    runs = Counter((Kind.of(study.setups[name]), count) for name, count in missing.items() if count)
    return group_size(runs, 1, threads)


def _scenes(study: Study, seconds: float) -> tuple[SceneCosts, ...]:
    kinds: dict[Hashable, list[str]] = {}
    for name, setup in study.setups.items():
        kinds.setdefault(alike(setup), []).append(name)
    found = []
    for names in kinds.values():
        setup = study.setups[names[0]]
        costs = measure(setup, seconds / len(kinds))
        found.append(SceneCosts(tuple(names), setup.physics.integrator, setup.physics.precision, costs))
    return tuple(found)


# --- trials ----------------------------------------------------------------------------------------------------


def still_epochs(setup: Setup) -> int:
    """Epochs of a run in which the morphology is that of the epoch before: kept behaviours are not tried again."""
    morphologies = [setup.morphology(epoch) for epoch in range(setup.epochs)]
    return sum(before == after for before, after in itertools.pairwise(morphologies))


def _work(study: Study, name: str, present: int, sizes: list[int], probes: Probes) -> Work:
    setup, missing = study.setups[name], sum(sizes)
    reused = missing * still_epochs(setup) * setup.search.parents
    trials = missing * setup.epochs * setup.search.population
    return Work(
        name, len(study.seeds), present, missing, trials, reused, (trials - reused) * steps(setup),
        physics=sum(_physics_seconds(setup, size, probes) for size in sizes),
        learning=sum(_learning_seconds(name, setup, size, probes) for size in sizes),
    )  # fmt: skip


def _physics_seconds(setup: Setup, seeds: int, probes: Probes) -> float:
    """Wall time of all calls of `simulate` for a group of runs."""
    search, still = setup.search, still_epochs(setup)
    whole = probes.call(setup, seeds * search.population)
    children = probes.call(setup, seeds * (search.population - search.parents)) if still else 0.0
    robots = len({setup.morphology(epoch) for epoch in range(setup.epochs)})
    return (setup.epochs - still) * whole + still * children + robots * probes.preparation(setup)


def _learning_seconds(name: str, setup: Setup, seeds: int, probes: Probes) -> float:
    """Wall time of everything else for a group of runs."""
    books = probes.books(name, seeds)
    return setup.epochs * books.epoch + seeds * books.commit


# --- memory and disk -------------------------------------------------------------------------------------------


def _memory(study: Study, name: str, sizes: list[int], probes: Probes, threads: int) -> tuple[int, int]:
    """Bytes that trials, and the tables of a group, take at most."""
    if not sizes:
        return 0, 0
    setup, seeds = study.setups[name], max(sizes)
    logged = seeds * setup.epochs * probes.books(name, seeds).logged
    # at the end of a group its columns stand there twice: as parts, and put together
    return trial_bytes(setup, seeds * setup.search.population, threads), int(2 * logged)


def trial_bytes(setup: Setup, n_trials: int, threads: int) -> int:
    """Bytes of the arrays of one call of `simulate`: rows of every block, work of those that run, what is read off."""
    system, method = system_and_method(setup)
    tag, n = lanes(setup.physics.precision, full_block(setup.physics)), system.n_nodes
    widths = block_widths(n_trials, threads, tag.width)
    work = method.workspace(tag, State(*(rows(n, tag) for _ in range(4))))
    item = tag.dtype.itemsize
    of_lane = item * (6 * n + len(system.rest) + 2 * setup.body.n_groups)
    of_trial = 2 * n * (item + 2 * 8) + 4 * 8 * 2 * setup.body.n_groups
    ticks = (2 * steps(setup) + 1) * 2 * (8 + item)
    return sum(widths) * of_lane + min(threads, len(widths)) * _nbytes(work) + n_trials * of_trial + ticks


def _nbytes(parts: Any) -> int:
    return parts.nbytes if isinstance(parts, np.ndarray) else sum(map(_nbytes, parts))


def resident() -> int:
    """Bytes of memory that this process has held at most, its libraries and kernels with it."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most


def _disk(study: Study, name: str, sizes: list[int], probes: Probes) -> tuple[int, int]:
    """Bytes of the results of all groups, and of the checkpoint of the largest."""
    if not sizes:
        return 0, 0
    epochs, books = study.setups[name].epochs, probes.books(name, max(sizes))
    return round(sum(sizes) * books.bytes_of(epochs)), round(max(sizes) * epochs * books.logged)


# --- measured here and now -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Books:
    """What a run costs besides its trials.

    Attributes
    ----------
    epoch : float
        Time of an epoch of the whole group: ranking, perturbing, logging, s.
    commit : float
        Time to store a run, s.
    run, per_epoch : float
        Bytes on the disk of a run, and of each of its epochs.
    logged : float
        Bytes in memory of an epoch of a run.
    """

    epoch: float
    commit: float
    run: float
    per_epoch: float
    logged: float

    def bytes_of(self, epochs: int) -> float:
        """Bytes of a run on the disk."""
        return self.run + epochs * self.per_epoch


class Probes:
    """Timings, each made once for all conditions that share it.

    Parameters
    ----------
    study : Study
    stored : mapping
        As for `explain`.
    threads : int
    """

    def __init__(self, study: Study, stored: Mapping[str, Mapping[str, Any]], threads: int) -> None:
        self.study, self.stored, self.threads = study, stored, threads
        self._known: dict[Hashable, Any] = {}

    def _once(self, key: Hashable, probe: Callable[[], Any]) -> Any:
        if key not in self._known:
            self._known[key] = probe()
        return self._known[key]

    def call(self, setup: Setup, n_trials: int) -> float:
        """Wall time of one call of `simulate`, s."""
        key = setup.body, setup.scene, setup.physics, setup.gait, setup.duration, n_trials
        return self._once(key, lambda: call_seconds(setup, n_trials, self.threads))

    def preparation(self, setup: Setup) -> float:
        """Time to make the integrator ready for another morphology, s."""
        return self._once((setup.body, setup.scene, setup.physics), lambda: _time(lambda: system_and_method(setup)))

    def books(self, condition: str, seeds: int) -> Books:
        """What a run of a group of so many seeds costs besides its trials."""
        setup, log = self.study.setups[condition], self.study.conditions[condition].log
        key = setup.search, setup.body.n_groups, setup.wobble is None, log, min(setup.epochs, LOGGED), seeds
        return self._once(key, lambda: keep_books(self.study, condition, self.stored[condition], seeds))


def call_seconds(setup: Setup, n_trials: int, threads: int) -> float:
    """Wall time of one call of `simulate`, from a shorter one if it takes long; kernels are compiled first."""
    behaviours = np.random.default_rng(0).random((n_trials, 2 * setup.body.n_groups))

    def call(n_steps: int) -> float:
        duration = n_steps * setup.physics.dt
        options = {"scene": setup.scene, "physics": setup.physics, "gait": setup.gait, "threads": threads}
        return _time(lambda: simulate(setup.body, behaviours, duration=duration, **options))

    whole, short = steps(setup), min(SHORT, steps(setup))
    call(short)
    overhead = min(call(short) for _ in range(3))
    longer = min(whole, 10 * SHORT)
    a_step = max(call(longer) - overhead, 1e-9) / max(longer - short, 1)
    probed = max(longer, min(whole, int(PROBE / a_step)))
    seconds = statistics.median(call(probed) for _ in range(3))
    return seconds + (whole - probed) * max(seconds - overhead, 0.0) / max(probed - short, 1)


def _time(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def keep_books(
    study: Study, condition: str, stored: Mapping[str, Any], seeds: int, patience: float = PATIENCE
) -> Books:
    """Run the learner on trials that cost nothing, with random scores; store what it has done in a passing folder."""
    setup = replace(study.setups[condition], epochs=min(LOGGED, study.setups[condition].epochs))
    learner = Learner(setup, range(seeds), simulate=_instant(setup))
    log, begun = Log(learner.seeds, study.conditions[condition].log), time.perf_counter()
    while not learner.done and (learner.epoch < 4 or time.perf_counter() < begun + patience):
        log.add(learner.advance())
    epoch = (time.perf_counter() - begun) / learner.epoch
    columns = log.columns()
    (few, less, _), (many, more, commit) = _stored(study, condition, stored, columns, learner.epoch)
    per_epoch = (more - less) / (many - few) if many > few else 0.0
    logged = sum(column.nbytes for column in columns.values()) / (learner.epoch * seeds)
    return Books(epoch, commit, more - many * per_epoch, per_epoch, logged)


def _stored(
    study: Study, condition: str, stored: Mapping[str, Any], columns: Mapping[str, np.ndarray], epochs: int
) -> list[tuple[int, int, float]]:
    """Epochs, bytes on the disk and time to store of a run of half as many epochs and of one of all."""
    found = []
    with tempfile.TemporaryDirectory() as folder, opened(Path(folder)) as store:
        written = study.conditions[condition].model_dump(mode="json")
        store.declare({condition: written}, (0, 1), "")
        for seed, part in enumerate((math.ceil(epochs / 2), epochs)):
            before, begun = _used(store.folder), time.perf_counter()
            some = {name: column[:part] for name, column in columns.items()}
            tables = run_tables(some, 0, seed, condition, stored, 0.0)
            store.commit([stage(attempt(store.scratch), (condition, seed), tables, json.dumps(written))])
            found.append((part, _used(store.folder) - before, time.perf_counter() - begun))
    return found


def _used(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _instant(setup: Setup) -> Callable[..., Trials]:
    """Trials of one step whose displacements are random; one is simulated, here."""
    lanes, rng = full_block(setup.physics), np.random.default_rng(0)
    behaviours = rng.random((lanes, 2 * setup.body.n_groups))
    options = {"scene": setup.scene, "physics": setup.physics, "gait": setup.gait, "duration": setup.physics.dt}
    known: dict[str, Any] = vars(simulate(setup.body, behaviours, threads=1, width=lanes, **options))

    def instant(body: Any, behaviours: np.ndarray, **_: Any) -> Trials:
        n = len(behaviours)
        alike: dict[str, Any] = {name: value if value is None else value[[0] * n] for name, value in known.items()}
        return replace(Trials(**alike), displacement=rng.normal(size=n))

    return instant
