"""A sweep from start to end: what is missing is computed, group by group, and stored."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from wobblesim.config import SweepConfig, dump, load_config
from wobblesim.physics.kernels import available_threads
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.study import resume
from wobblesim.study.engines.contract import OpenEngine
from wobblesim.study.engines.local import local
from wobblesim.study.fork import take_over
from wobblesim.study.lock import Shard
from wobblesim.study.plan import Plan, Study, lane_steps, plan, study
from wobblesim.study.progress import Meter, Progress
from wobblesim.study.provenance import kernel_hash
from wobblesim.study.store import Store, opened
from wobblesim.study.work import Interval, Job, Receipt


@dataclass(frozen=True)
class Outcome:
    """What a call of `sweep` has come to.

    Attributes
    ----------
    folder : Path
        Of the results.
    wanted, present, done : int
        Runs: asked for; there before the call; computed by it.
    failed : int
        Of the runs asked for, those that came to nothing, now or before: the learner raised (such a run is tried again
        by the next call), or no trial of the last epoch has a score.
    stopped : bool
        Whether `stop` ended it early; the same call goes on.
    seconds : float
        Wall time of the call.
    """

    folder: Path
    wanted: int
    present: int
    done: int
    failed: int
    stopped: bool
    seconds: float


def sweep(
    config: SweepConfig | str | Path,
    out: str | Path,
    *,
    threads: int | None = None,
    engine: OpenEngine | None = None,
    shard: Shard | None = None,
    fork_of: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
    checkpoint: Interval = Interval(),
    simulate: Callable[..., Trials] = simulate,
) -> Outcome:
    """Compute the missing runs of a study and store them.

    The same call again goes on where it was stopped or killed, with the same bits; more seeds and more conditions are
    added to what is there.

    Parameters
    ----------
    config : SweepConfig or path
    out : path
        Folder of the results, made if need be.
    threads : int, optional
        At most this many; all that Numba may use if not given.
    engine : context manager of an Engine, optional
        Where the runs are computed: `wobblesim.study.engines.cluster.cluster` for worker processes; here if not given.
    shard : Shard, optional
        Compute only this part of the runs, beside other processes that compute the others.
    fork_of : path, optional
        Folder of other results: those of conditions that are the same there are taken over.
    progress : callable, optional
        Called with a `Progress` after every epoch, run and trouble.
    stop : callable, optional
        Asked after every epoch; once it says True, checkpoints are written and the sweep ends.
    checkpoint : Interval
        When checkpoints are written.
    simulate : callable
        Called as `wobblesim.simulate` is; another one makes another task of it. An engine that is given has its own.

    Raises
    ------
    ConfigError, PlanError
        If the configuration cannot be run.
    StoreError
        If the folder cannot be written to, is in use, or holds results of other settings.
    """
    started = time.monotonic()
    if not isinstance(config, SweepConfig):
        config = load_config(config)
    whole = study(config)
    mine = whole.shard(shard.number, shard.count) if shard else whole
    with opened(Path(out), shard, _digest(config)) as store:
        wanted = {name: settings for name, settings in whole.written.items() if mine.seeds_of(name)}
        store.declare(wanted, whole.seeds, dump(_with_stored_seeds(config, store)))
        notes = [*store.manifest.unreadable, *store.lost, *([] if shard else resume.sweep_up(store.folder))]
        if fork_of is not None:
            notes += take_over(Path(fork_of), store, mine)
        with engine or local(threads or available_threads(), simulate) as work:
            todo = _todo(store, mine, work.workers, work.threads)
            meter = _meter(store, mine, todo, progress or (lambda _: None))
            meter.tell("begin")
            for note in notes:
                meter.tell("note", note)
            jobs, settled = _jobs(store, mine, todo, checkpoint), 0
            for receipt in work(jobs, meter.hear, stop or (lambda: False)):
                _settle(store, mine, meter, receipt)
                settled += not receipt.stopped
            meter.tell("end")
    stopped, seconds = settled < len(todo), time.monotonic() - started
    return Outcome(store.folder, meter.wanted, meter.present, meter.done, meter.failed, stopped, seconds)


def _digest(config: SweepConfig) -> str:
    """What tells studies apart."""
    return hashlib.sha256(dump(config).encode()).hexdigest()[:16]


def _with_stored_seeds(config: SweepConfig, store: Store) -> SweepConfig:
    """The configuration with the seeds asked for earlier besides its own: all are part of the study in this folder."""
    earlier = {seed for _, seeds in store.manifest.studies for seed in seeds}
    if earlier <= set(config.seeds):
        return config
    return config.model_copy(update={"seeds": tuple(sorted(earlier.union(config.seeds)))})


def _todo(store: Store, study: Study, workers: int, threads: int) -> Plan:
    """The groups to compute: those begun before, then fresh ones."""
    present = store.manifest.runs.keys()
    begun = resume.begun(store.folder, store.manifest.conditions, present)
    return plan(study, present, resume.useful(begun, study.asks_for, present), workers, threads)


def _meter(store: Store, study: Study, todo: Plan, tell: Callable[[Progress], None]) -> Meter:
    stored = [run for key, run in store.manifest.runs.items() if study.asks_for(key)]
    failed = sum(run.status == "failed" for run in stored)
    return Meter(tell, wanted=study.n_runs, present=len(stored), failed=failed, work=todo.work(study))


def _jobs(store: Store, study: Study, todo: Plan, checkpoint: Interval) -> Iterator[Job]:
    """The groups with all that a worker needs for them."""
    folder, kernel = store.folder.resolve(), kernel_hash()
    for group in todo:
        missing = tuple(seed for seed in group.seeds if (group.condition, seed) not in store.manifest.runs)
        identity = resume.identity(store.manifest.conditions[group.condition])
        parameters = study.conditions[group.condition]
        yield Job(folder, store.scratch.resolve(), group, missing, parameters, identity, kernel, checkpoint)


def _settle(store: Store, study: Study, meter: Meter, receipt: Receipt) -> None:
    """Make what came of a job results, or note that it came to nothing."""
    group = receipt.job.group
    if receipt.error:
        store.fail(group.condition, receipt.job.missing, receipt.error)
        meter.fail(receipt, len(group.seeds) * lane_steps(study.setups[group.condition], receipt.epoch))
    elif not receipt.stopped:
        store.commit(receipt.lines)
        meter.finish(receipt)
        resume.discard(store.folder, group)
