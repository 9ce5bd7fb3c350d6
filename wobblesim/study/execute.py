"""A sweep from start to end: what is missing is computed, group by group, and stored."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from wobblesim.config import ConfigError, SweepConfig, columns, dump, load_config
from wobblesim.learning.run import Learner, Setup
from wobblesim.physics.kernels import available_threads
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.study import resume
from wobblesim.study.plan import Group, Study, group_size, groups, lane_steps, study
from wobblesim.study.progress import Meter, Progress
from wobblesim.study.rows import Log, run_tables
from wobblesim.study.store import CONFIG, Store, opened

CHECKPOINT_EVERY = 30.0
"""Wall time between two checkpoints of a group, s: what a sudden death costs."""


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
    progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
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
    progress : callable, optional
        Called with a `Progress` after every epoch, run and trouble.
    stop : callable, optional
        Asked after every epoch; once it says True, a checkpoint is written and the sweep ends.
    checkpoint_every : float
        Wall time between two checkpoints, s.
    simulate : callable
        Called as `wobblesim.simulate` is; another one makes another task of it.

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
    laid_out = study(config)
    setups = laid_out.setups
    with opened(Path(out)) as store:
        store.declare(laid_out.written)
        store.write_config(dump(_with_stored_seeds(config, store.folder)))
        notes = [*store.manifest.unreadable, *store.lost, *resume.sweep_up(store.folder)]
        todo = _todo(store, laid_out, group_size(threads or available_threads()))
        meter = _meter(store, laid_out, todo, setups, progress or (lambda _: None))
        work = _Sweep(store, laid_out, setups, meter, threads, stop or (lambda: False), checkpoint_every, simulate)
        stopped = work.run(todo, notes)
    return Outcome(
        store.folder, meter.wanted, meter.present, meter.done, meter.failed, stopped, time.monotonic() - started
    )


def _with_stored_seeds(config: SweepConfig, folder: Path) -> SweepConfig:
    """The configuration with the seeds asked for earlier besides its own: all are part of the study in this folder."""
    if not (folder / CONFIG).exists():
        return config
    try:
        earlier = load_config(folder / CONFIG).seeds
    except ConfigError:
        return config
    return config.model_copy(update={"seeds": tuple(sorted({*earlier, *config.seeds}))})


def _todo(store: Store, study: Study, size: int) -> list[Group]:
    """The groups to compute: those begun before, then fresh ones of `size` seeds."""
    present = store.present()
    begun = resume.begun(store.folder, store.manifest.conditions, present)
    missing = [run for run in study.runs if run not in present]
    return groups(missing, size, resume.useful(begun, study.runs, present))


def _meter(
    store: Store, study: Study, todo: list[Group], setups: dict[str, Setup], tell: Callable[[Progress], None]
) -> Meter:
    stored = [store.manifest.runs[run] for run in study.runs if run in store.manifest.runs]
    return Meter(
        tell,
        wanted=len(study.runs),
        present=len(stored),
        failed=sum(run["status"] == "failed" for run in stored),
        work=sum(len(group.seeds) * lane_steps(setups[group.condition]) for group in todo),
    )


class _Failed(Exception):  # noqa: N818 - it is not the error, it carries it
    """The learner of a group raised; its exception is the cause."""


@dataclass
class _Sweep:
    """A sweep in progress."""

    store: Store
    study: Study
    setups: dict[str, Setup]
    meter: Meter
    threads: int | None
    stop: Callable[[], bool]
    checkpoint_every: float
    simulate: Callable[..., Trials]

    def run(self, todo: list[Group], notes: list[str]) -> bool:
        """Compute groups; return whether they were stopped early."""
        self.meter.tell("begin")
        for note in notes:
            self.meter.tell("note", note)
        stopped = not all(self._finish(group) for group in todo)
        self.meter.tell("end")
        return stopped

    def _finish(self, group: Group) -> bool:
        """Compute and store a group, or note that it came to nothing; return False if stopped before its end."""
        if self.stop():
            return False
        try:
            return self._compute(group)
        except _Failed as failed:
            self._give_up(group, failed)
            return True

    def _compute(self, group: Group) -> bool:
        begun = time.monotonic()
        log = Log(group.seeds, self.study.conditions[group.condition].log)
        learner, spent = self._learner(group, log)
        self._enter(group, learner)
        saved = begun
        while not learner.done:
            self._advance(learner, log)
            stopped, due = self.stop(), time.monotonic() - saved >= self.checkpoint_every
            if not learner.done and (stopped or due):
                saved = time.monotonic()
                self._save(group, learner, log, spent + saved - begun)
                if stopped:
                    return False
        self._commit(group, log, spent + time.monotonic() - begun)
        return True

    def _learner(self, group: Group, log: Log) -> tuple[Learner, float]:
        """The learner of a group, from its checkpoint if it has one, and the seconds spent on it so far."""
        setup = self.setups[group.condition]
        checkpoint = resume.load(self.store.folder, group, self._identity(group))
        try:
            if checkpoint is None:
                return Learner(setup, group.seeds, self.threads, simulate=self.simulate), 0.0
            log.restore(checkpoint.parts)
            restored = Learner.restored(setup, group.seeds, checkpoint.snapshot, self.threads, simulate=self.simulate)
            return restored, checkpoint.seconds
        except Exception as error:
            raise _Failed from error

    def _enter(self, group: Group, learner: Learner) -> None:
        setup, meter = learner.setup, self.meter
        meter.group, meter.epoch, meter.epochs = str(group), learner.epoch, setup.epochs
        meter.skip(len(group.seeds) * (lane_steps(setup) - lane_steps(setup, learner.epoch)))

    def _advance(self, learner: Learner, log: Log) -> None:
        try:
            epoch = learner.advance()
        except Exception as error:
            raise _Failed from error
        log.add(epoch)
        self.meter.epoch = learner.epoch
        work = lane_steps(learner.setup, epoch.epoch) - lane_steps(learner.setup, learner.epoch)
        diverged, refined = (int((epoch.status == status).sum()) for status in ("diverged", "refined"))
        self.meter.count(len(learner.seeds) * work, diverged, refined)
        self.meter.tell("epoch")

    def _save(self, group: Group, learner: Learner, log: Log, seconds: float) -> None:
        part = log.cut()
        resume.save(self.store.folder, group, self._identity(group), learner.snapshot(), part, log.parts, seconds)

    def _identity(self, group: Group) -> str:
        return resume.identity(self.store.manifest.conditions[group.condition])

    def _commit(self, group: Group, log: Log, seconds: float) -> None:
        """Store the runs of a group that are not there yet."""
        epochs = log.columns()
        settings = columns(self.study.conditions[group.condition])
        share = seconds / len(group.seeds)
        for index, seed in enumerate(group.seeds):
            if (group.condition, seed) not in self.store.manifest.runs:
                tables = run_tables(epochs, index, seed, group.condition, settings, share)
                self.store.commit((group.condition, seed), tables)
                self.meter.finish(f"{group.condition}, seed {seed}: {_said(tables)}", failed=_failed(tables))
        resume.discard(self.store.folder, group)

    def _give_up(self, group: Group, failed: _Failed) -> None:
        """Note that a group came to nothing, and why."""
        error = failed.__cause__
        missing = [seed for condition, seed in group.runs if (condition, seed) not in self.store.manifest.runs]
        self.store.fail(group.condition, missing, "".join(traceback.format_exception(error)))
        setup = self.setups[group.condition]
        self.meter.skip(len(group.seeds) * lane_steps(setup, self.meter.epoch))
        self.meter.fail(len(missing), f"{group}: failed in epoch {self.meter.epoch}: {_one_line(error)}")


def _failed(tables: dict[str, pa.Table]) -> bool:
    return tables["runs"]["status"][0].as_py() == "failed"


def _said(tables: dict[str, pa.Table]) -> str:
    """The result of a run in words."""
    if _failed(tables):
        return "failed, all trials of the last epoch diverged"
    run = tables["runs"].select(["performance", "diverged", "refined"]).to_pylist()[0]
    trouble = "".join(f", {run[status]} trials {status}" for status in ("diverged", "refined") if run[status])
    return f"{run['performance']:.3f} body lengths{trouble}"


def _one_line(error: BaseException | None) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
