"""Processes to be killed, stopped and refused: each is a fork of a server that has imported all that is needed."""

from __future__ import annotations

import encodings.utf_8_sig  # noqa: F401 - who has become nobody finds no more modules
import functools
import multiprocessing
import os
import resource
import shutil
import signal
import time
from collections.abc import Callable
from multiprocessing import forkserver
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any
from unittest import mock

import pyarrow as pa
from study.toy import slow_toy, study, toy

import wobblesim.analysis.figures.learning
import wobblesim.commands.sweep  # noqa: F401
from wobblesim.commands import main
from wobblesim.config import SweepConfig
from wobblesim.physics import kernels
from wobblesim.physics.simulate import Trials
from wobblesim.study import execute
from wobblesim.study.lock import Shard
from wobblesim.study.progress import Progress
from wobblesim.study.provenance import provenance
from wobblesim.study.store import attempt, opened, stage
from wobblesim.study.work import Interval

SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["faults.children"])

PATH = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]


def started(target: Callable[..., None], *arguments: Any) -> ForkServerProcess:
    """A process that calls a function of this module."""
    with mock.patch.dict(os.environ, {"PYTHONPATH": os.pathsep.join(PATH)}):
        forkserver.ensure_running()  # what it imports it looks for where any Python does
    process = SERVER.Process(target=target, args=arguments, daemon=True)
    process.start()
    return process


def wait_for(happened: Callable[[], Any], process: ForkServerProcess | None = None, seconds: float = 60.0) -> Any:
    """Wait until something has happened, in a process that is to live meanwhile; return what."""
    deadline = time.monotonic() + seconds
    while not (what := happened()):
        assert process is None or process.is_alive(), "the process has ended"
        assert time.monotonic() < deadline, "it takes too long"
        time.sleep(0.002)
    return what


class Diary:
    """Lines that survive their writer."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def write(self, *words: object) -> None:
        """Add a line."""
        os.write(self._file, (" ".join(map(str, words)) + "\n").encode())


# --- sweeps --------------------------------------------------------------------------------------------------------

HUNDRED = ("learning.epochs=6", "log=epochs")


def hundred() -> SweepConfig:
    """Two conditions of 50 short runs."""
    return study(*HUNDRED, seeds="0..49")


def sweep_hundred(folder: Path, diary: Path) -> None:
    """Compute the hundred runs, and write down what is told."""
    told = Diary(diary)

    def heard(progress: Progress) -> None:
        name = progress.message.partition(":")[0] if progress.kind == "run" else progress.group
        told.write(progress.kind, progress.present, name)

    execute.sweep(hundred(), folder, simulate=slow_toy(0.002), progress=heard, checkpoint=Interval(seconds=0.05))


LONG = "conditions={mass: {wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 200}}}"


def long(epochs: int) -> SweepConfig:
    """One group of two runs."""
    return study(LONG, f"learning.epochs={epochs}", "log=epochs", seeds="0..1")


def sweep_long(folder: Path, diary: Path, epochs: int, interval: Interval, deadly: int) -> None:
    """Compute the long runs; kill this process in the epoch that is the `deadly`-th that it computes."""
    told, left = Diary(diary), [deadly]

    def simulate(*arguments: Any, **settings: Any) -> Trials:
        told.write(time.monotonic())
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.002)
        return toy(*arguments, **settings)

    execute.sweep(long(epochs), folder, simulate=simulate, checkpoint=interval)


# --- locks and commits ---------------------------------------------------------------------------------------------


def hold(folder: Path, held: Path, shard: Shard | None = None, name: str = "") -> None:
    """Hold a folder, and say so with a file, until killed."""
    with opened(folder, shard, name):
        held.touch()
        time.sleep(600)


def commit_many(folder: Path, shard: Shard, count: int) -> None:
    """Commit runs one by one, seeds `shard.number` * 1000 and up."""
    with opened(folder, shard, "many") as store:
        store.declare({"fixed": {"log": "epochs"}}, range(count), "name: many\n")
        for seed in range(1000 * shard.number, 1000 * shard.number + count):
            columns = {"seed": [seed], "status": ["ok"], "diverged": [0], "refined": [0]}
            scratch = attempt(store.scratch)
            store.commit([stage(scratch, ("fixed", seed), {"runs": pa.table(columns)}, "{}")])


# --- the command line ----------------------------------------------------------------------------------------------


def command(
    arguments: list[str],
    said: Path,
    before: Callable[..., object] | None = None,
    each: Callable[..., object] | None = None,
    *given: Any,
) -> None:
    """`wobblesim` on a toy; what it says goes to files.

    Parameters
    ----------
    arguments : list of str
    said : Path
        Folder of the files stdout and stderr.
    before, each : callable, optional
        Called first of all, and in every epoch, with `given`.
    """
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(os.open(said / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666), number)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if before:
        before(*given)

    def simulate(*arguments: Any, **settings: Any) -> Trials:
        if each:
            each(*given)
        return toy(*arguments, **settings)

    execute.sweep = functools.partial(execute.sweep, simulate=simulate)  # type: ignore[assignment]
    main(arguments)


def sleep_a_little(*_: Any) -> None:
    """Take some time for an epoch."""
    time.sleep(0.02)


def sleep_for_ever(*_: Any) -> None:
    """Take more time for an epoch than anybody waits, and say when it begins."""
    os.write(2, b"asleep\n")
    time.sleep(600)


def ignore_hangup(*_: Any) -> None:
    """What nohup does."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)


def lose_readers(*_: Any) -> None:
    """Have nobody read what is said."""
    for number in (1, 2):
        ours, theirs = os.pipe()
        os.dup2(theirs, number)
        os.close(ours)
        os.close(theirs)


def lose_stderr(*_: Any) -> None:
    """Have nobody read standard error."""
    ours, theirs = os.pipe()
    os.dup2(theirs, 2)
    os.close(ours)
    os.close(theirs)


def take_terminal(terminal: str) -> None:
    """Run on a terminal of its own."""
    os.setsid()
    handle = os.open(terminal, os.O_RDWR)  # a session without a terminal takes the first that it opens
    for number in (0, 1, 2):
        os.dup2(handle, number)


def limit_files(*_: Any) -> None:
    """Refuse files of more than 30,000 bytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))


def become_nobody(*_: Any) -> None:
    """Drop all privileges, and root's compiled kernels."""
    kernels.FOLDER = None
    provenance()  # it looks into folders that others may not see
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)


def remove_later(folder: Path, *_: Any) -> None:
    """Remove a folder once two runs are there."""
    if len(list(folder.glob("runs/*/*.parquet"))) > 1:
        shutil.rmtree(folder)


def protect_later(folder: Path, *_: Any) -> None:
    """Let nobody write to a folder once two runs are there."""
    if len(list(folder.glob("runs/*/*.parquet"))) > 1:
        for path in (folder, *(path for path in folder.rglob("*") if path.is_dir())):
            path.chmod(0o555)
