"""One job: a group of runs in lockstep, from its first epoch or its checkpoint to tables that wait to be results.

This is all that a worker does, in whatever process on whatever machine. It writes into the checkpoint of its group and
into a scratch folder of its own; the process that holds the results folder moves the tables to their places.
"""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from wobblesim.config import Parameters, columns
from wobblesim.learning.run import Learner
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.study import resume
from wobblesim.study.errors import StoreError
from wobblesim.study.plan import Group, lane_steps, setup
from wobblesim.study.provenance import kernel_hash, provenance, without_places
from wobblesim.study.rows import Log, run_tables
from wobblesim.study.schema import row
from wobblesim.study.store import as_stored, attempt, stage

WRITERS = 4
"""Threads that write the runs of a group: while one waits for the disk, another packs."""


@dataclass(frozen=True)
class Interval:
    """When a checkpoint is due: so long, or so many epochs, after the one before.

    Attributes
    ----------
    seconds : float
        Wall time: what a sudden death costs.
    epochs : int or None
    """

    seconds: float = 30.0
    epochs: int | None = None

    def is_over(self, seconds: float, epochs: int) -> bool:
        """Whether a checkpoint is due."""
        return seconds >= self.seconds or (self.epochs is not None and epochs >= self.epochs)


@dataclass(frozen=True)
class Job:
    """All that a worker needs to compute a group of runs.

    Attributes
    ----------
    folder, scratch : Path
        Of the results, and where files are made; absolute, the same for all workers.
    group : Group
    missing : tuple of int
        Seeds of the group that are to be stored; the others are there already.
    parameters : Parameters
        Settings of the condition.
    identity : str
        Of the condition, as checkpoints have it.
    kernel : str
        Hash of the simulator that is to compute it.
    checkpoint : Interval
    """

    folder: Path
    scratch: Path
    group: Group
    missing: tuple[int, ...]
    parameters: Parameters
    identity: str
    kernel: str
    checkpoint: Interval = Interval()


@dataclass(frozen=True)
class Beat:
    """How far a job is.

    Attributes
    ----------
    group : Group
    epoch, epochs : int
        Done and wanted.
    work : int
        Lane-steps since the beat before.
    skipped : int
        Lane-steps that an earlier command did.
    diverged, refined : int
        Trials since the beat before.
    """

    group: Group
    epoch: int
    epochs: int
    work: int = 0
    skipped: int = 0
    diverged: int = 0
    refined: int = 0


@dataclass(frozen=True)
class Receipt:
    """What came of a job.

    Attributes
    ----------
    job : Job
    lines : tuple of dict
        Of the manifest, one a run, see `store.stage`.
    said : tuple of str
        The result of each run in words.
    stopped : bool
        Whether it ended early, with a checkpoint.
    error : str
        Why it came to nothing, as a traceback; empty if it did not.
    epoch : int
        Epochs done.
    """

    job: Job
    lines: tuple[Mapping[str, Any], ...] = ()
    said: tuple[str, ...] = ()
    stopped: bool = False
    error: str = ""
    epoch: int = 0


def compute(
    job: Job,
    heard: Callable[[Beat], None],
    stop: Callable[[], bool],
    threads: int,
    simulate: Callable[..., Trials] = simulate,
) -> Receipt:
    """Compute a group of runs, from its checkpoint if it has one.

    Parameters
    ----------
    job : Job
    heard : callable
        Told how far the job is, at its begin and after each epoch.
    stop : callable
        Asked after each epoch; once it says True, a checkpoint is written and the job ends.
    threads : int
    simulate : callable
        Called as `wobblesim.simulate` is.

    Raises
    ------
    WriteError
        If a file cannot be written.
    StoreError
        If this is another simulator than the study was laid out for.
    """
    provenance()  # of what begins to compute now, not of what stands in the folder of the sources hours later
    if kernel_hash() != job.kernel:
        raise StoreError(
            f"a worker has another simulator (kernel {kernel_hash()} instead of {job.kernel}); "
            "give all workers the same version of wobblesim, Numba and NumPy"
        )
    return _Work(job, heard, stop, threads, simulate).run()


class _Failed(Exception):  # noqa: N818 - it is not the error, it carries it
    """The learner of a group raised; its exception is the cause."""


@dataclass
class _Work:
    """A job in progress."""

    job: Job
    heard: Callable[[Beat], None]
    stop: Callable[[], bool]
    threads: int
    simulate: Callable[..., Trials]

    def run(self) -> Receipt:
        """Advance the learner to its end, or until stopped."""
        begun = saved = time.monotonic()
        log, learner = Log(self.job.group.seeds, self.job.parameters.log), None
        try:
            learner, spent = self._learner(log)
            at_save = learner.epoch
            self._enter(learner)
            while not learner.done:
                self._advance(learner, log)
                stopped, now = self.stop(), time.monotonic()
                due = self.job.checkpoint.is_over(now - saved, learner.epoch - at_save)
                if not learner.done and (stopped or due):
                    self._save(learner, log, spent + now - begun)
                    saved, at_save = time.monotonic(), learner.epoch
                    if stopped:
                        return Receipt(self.job, stopped=True, epoch=learner.epoch)
        except _Failed as failed:
            error = without_places("".join(traceback.format_exception(failed.__cause__)))
            return Receipt(self.job, error=error, epoch=learner.epoch if learner else 0)
        return self._stored(log, learner.epoch, spent + time.monotonic() - begun)

    def _learner(self, log: Log) -> tuple[Learner, float]:
        """The learner of the group, from its checkpoint if it has one, and the seconds spent on it so far."""
        job = self.job
        checkpoint = resume.load(job.folder, job.group, job.identity)
        try:
            made = setup(job.parameters)
            if checkpoint is None:
                return Learner(made, job.group.seeds, self.threads, simulate=self.simulate), 0.0
            log.restore(checkpoint.parts)
            snapshot = checkpoint.snapshot
            learner = Learner.restored(made, job.group.seeds, snapshot, self.threads, simulate=self.simulate)
            return learner, checkpoint.seconds
        except Exception as error:
            raise _Failed from error

    def _enter(self, learner: Learner) -> None:
        done = lane_steps(learner.setup) - lane_steps(learner.setup, learner.epoch)
        self.heard(Beat(self.job.group, learner.epoch, learner.setup.epochs, skipped=len(self.job.group.seeds) * done))

    def _advance(self, learner: Learner, log: Log) -> None:
        try:
            epoch = learner.advance()
        except Exception as error:
            raise _Failed from error
        log.add(epoch)
        made = learner.setup
        work = len(learner.seeds) * (lane_steps(made, epoch.epoch) - lane_steps(made, learner.epoch))
        diverged, refined = (int((epoch.status == status).sum()) for status in ("diverged", "refined"))
        self.heard(Beat(self.job.group, learner.epoch, made.epochs, work=work, diverged=diverged, refined=refined))

    def _save(self, learner: Learner, log: Log, seconds: float) -> None:
        job, part = self.job, log.cut()
        resume.save(job.folder, job.scratch, job.group, job.identity, learner.snapshot(), part, log.parts, seconds)

    def _stored(self, log: Log, epoch: int, seconds: float) -> Receipt:
        """Write the tables of the missing runs where they wait to be results."""
        job, epochs = self.job, log.columns()
        scratch, share = attempt(job.scratch), seconds / len(job.group.seeds)
        settings = row(columns(job.parameters))
        config = json.dumps(as_stored(job.parameters.model_dump(mode="json")))

        def store(index: int) -> tuple[dict[str, Any], str]:
            run = job.group.condition, job.group.seeds[index]
            tables = run_tables(epochs, index, run[1], run[0], settings, share)
            return stage(scratch, run, tables, config), f"{run[0]}, seed {run[1]}: {_said(tables)}"

        missing = [index for index, seed in enumerate(job.group.seeds) if seed in job.missing]
        with ThreadPoolExecutor(WRITERS) as pool:
            found = list(pool.map(store, missing))
        return Receipt(job, tuple(line for line, _ in found), tuple(said for _, said in found), epoch=epoch)


def _said(tables: Mapping[str, pa.Table]) -> str:
    """The result of a run in words."""
    run = tables["runs"].select(["status", "performance", "diverged", "refined"]).to_pylist()[0]
    if run["status"] == "failed":
        return "failed, all trials of the last epoch diverged"
    trouble = "".join(f", {run[status]} trials {status}" for status in ("diverged", "refined") if run[status])
    return f"{run['performance']:.3f} body lengths{trouble}"
