"""Signals end a sweep in order, and at once if they insist (CR-12), whoever reads what it says."""

import contextlib
import os
import pty
import signal
import time

import pytest
from faults import children
from faults.children import started, wait_for
from faults.scenarios import check_sound, read
from study.toy import study, toy

from wobblesim.config import dump
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import read_manifest
from wobblesim.study.store import CHECKPOINTS

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

LONG = ("learning.epochs=40", "log=epochs")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The rows of a study that nothing disturbs."""
    folder = tmp_path_factory.mktemp("whole")
    sweep(study(*LONG, seeds="0..1"), folder, simulate=toy)
    return read(folder)[0]


@pytest.fixture
def command(tmp_path):
    """Starts the command line on the toy; kills it in the end."""
    (tmp_path / "study.yaml").write_text(dump(study(*LONG, seeds="0..1")))
    processes = []

    def start(before=None, each=children.sleep_a_little, *given, progress="plain"):
        arguments = ["sweep", str(tmp_path / "study.yaml"), "--out", str(tmp_path / "results"), "--progress", progress]
        processes.append(started(children.command, arguments, tmp_path, before, each, *given))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.join()


def is_in_its_second_group(folder):
    """A group is stored, and the other one, of 0.8 s, is in progress."""
    if len(read_manifest(folder / "results").runs) < 2:
        return False
    time.sleep(0.1)
    return True


def said(folder):
    """What a command has said on standard error so far."""
    path = folder / "stderr"
    return path.read_text() if path.exists() else ""


def check_resumes(tmp_path, whole):
    """Finished runs are there, the others go on from a checkpoint to the same rows."""
    folder = tmp_path / "results"
    assert len(read_manifest(folder).runs) == 2
    assert len(list(folder.glob(f"{CHECKPOINTS}/*/*/state.npz"))) == 1
    told = []
    outcome = sweep(study(*LONG, seeds="0..1"), folder, simulate=toy, progress=told.append)
    assert (outcome.present, outcome.done) == (2, 2)
    assert told[1].epoch > 1  # not from the start
    check_sound(folder, whole)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_ends_a_sweep_with_a_checkpoint_and_the_line_to_type(tmp_path, command, whole, number, injected):
    process = command()
    wait_for(lambda: is_in_its_second_group(tmp_path), process)
    began = time.monotonic()
    os.kill(process.pid, number)
    process.join(10)
    assert time.monotonic() - began < 10.0  # measured 0.6: an epoch, a checkpoint and the picture
    assert process.exitcode == 4
    assert "stopping after this epoch, with a checkpoint" in said(tmp_path)
    told = said(tmp_path).splitlines()[-1]
    assert told.startswith("stopped; to go on: ")
    assert f"sweep {tmp_path / 'study.yaml'} --out {tmp_path / 'results'}" in told
    check_resumes(tmp_path, whole)
    injected("signal to stop")


@pytest.mark.parametrize("number", SIGNALS)
def test_the_second_signal_ends_it_at_once(tmp_path, command, number, injected):
    process = command(None, children.sleep_for_ever)
    wait_for(lambda: "asleep" in said(tmp_path), process)
    os.kill(process.pid, number)
    wait_for(lambda: "stopping after" in said(tmp_path), process)
    if number == signal.SIGHUP:  # which comes twice or thrice when a terminal is closed
        os.kill(process.pid, number)
        time.sleep(2.1)
        assert process.is_alive()
    began = time.monotonic()
    os.kill(process.pid, number)
    process.join(10)
    assert process.exitcode == 128 + number
    assert time.monotonic() - began < 1.0  # measured 0.01
    injected("second signal to stop")


def test_a_sweep_under_nohup_does_not_hear_that_the_terminal_is_gone(tmp_path, command, whole, injected):
    process = command(children.ignore_hangup)
    wait_for(lambda: is_in_its_second_group(tmp_path), process)
    os.kill(process.pid, signal.SIGHUP)
    process.join(30)
    assert process.exitcode == 0
    check_sound(tmp_path / "results", whole)
    injected("signal to stop")


@pytest.mark.parametrize("progress", ["plain", "rich", "none"])
def test_a_closed_terminal_costs_nothing(tmp_path, command, whole, progress, injected):
    ours, theirs = pty.openpty()
    process = command(children.take_terminal, children.sleep_a_little, os.ttyname(theirs), progress=progress)
    os.set_blocking(ours, False)
    os.close(theirs)
    wait_for(lambda: _drained(ours) and is_in_its_second_group(tmp_path), process)
    os.close(ours)
    process.join(10)
    assert process.exitcode == 4
    check_resumes(tmp_path, whole)
    injected("terminal closed")


def _drained(terminal):
    """Read what a terminal has to show, lest its writer waits for ever."""
    with contextlib.suppress(OSError):  # nothing, or nobody has opened it yet
        os.read(terminal, 65536)
    return True


@pytest.mark.parametrize("progress", ["plain", "rich"])
def test_a_sweep_goes_on_when_nobody_reads_standard_error(tmp_path, command, whole, progress, injected):
    process = command(children.lose_stderr, None, progress=progress)
    process.join(30)
    assert process.exitcode == 0
    assert "results: " in (tmp_path / "stdout").read_text()
    check_sound(tmp_path / "results", whole)
    injected("standard error closed")
