"""The dask engine: the same rows and bits as in one process, whatever becomes of the workers."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from study.toy import content, slow_toy, study, toy

from wobblesim.config import load_config
from wobblesim.physics.kernels import available_threads
from wobblesim.physics.simulate import simulate
from wobblesim.study import execute, resume
from wobblesim.study.engines.cluster import cluster
from wobblesim.study.engines.dispatch import Dispatch, Effort
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import read_manifest
from wobblesim.study.plan import Group
from wobblesim.study.store import CHECKPOINTS, StoreError
from wobblesim.study.work import Interval

ROOT = Path(__file__).parents[2]
EVERY_EPOCH = Interval(epochs=1)


SAID = []


@pytest.fixture(scope="module")
def pair():
    """Two workers of one thread, kept over the tests of this file."""
    with cluster(2, 1, simulate=slow_toy(0.05), said=SAID.append) as engine:
        yield engine


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The content of the study as one process computes it, and what it told."""
    folder, told = tmp_path_factory.mktemp("whole"), []
    sweep(study(), folder, simulate=toy, progress=told.append)
    return content(folder), told


def pids(engine):
    return list(engine.client.run(os.getpid, on_error="ignore").values())


def within(seconds, question):
    """Whether the answer becomes yes in time."""
    deadline = time.monotonic() + seconds
    while not (answer := question()) and time.monotonic() < deadline:
        time.sleep(0.05)
    return answer


class After:
    """Says yes once a sweep, whose progress it hears, has told of so many epochs."""

    def __init__(self, epochs):
        self.left = epochs

    def hear(self, told):
        self.left -= told.kind == "epoch"

    def __call__(self):
        return self.left <= 0


# --- DT-4: the same bits from every engine -------------------------------------------------------------------------


def test_two_workers_give_the_rows_of_one_process(tmp_path, whole, pair):
    outcome = sweep(study(), tmp_path, engine=nullcontext(pair))
    assert (outcome.done, outcome.failed, outcome.stopped) == (8, 0, False)
    assert content(tmp_path) == whole[0]


def test_one_worker_gives_the_rows_of_one_process_on_all_processors(tmp_path, whole):
    with cluster(1, simulate=toy) as engine:
        assert engine.threads == available_threads()
        assert set(engine.client.run(available_threads).values()) == {available_threads()}
        sweep(study(), tmp_path, engine=nullcontext(engine))
    assert content(tmp_path) == whole[0]


def test_workers_have_the_threads_they_are_given(pair):
    assert (pair.workers, pair.threads) == (2, 1)
    assert set(pair.client.run(available_threads).values()) == {1}


@pytest.mark.parametrize("first", ["local", "dask"])
def test_what_one_engine_begins_another_ends(tmp_path, whole, pair, first):
    engines = {"local": None, "dask": nullcontext(pair)}
    stop = After(1)
    stopped = sweep(
        study(),
        tmp_path,
        engine=engines.pop(first),
        simulate=toy,
        stop=stop,
        progress=stop.hear,
        checkpoint=EVERY_EPOCH,
    )
    assert stopped.stopped
    assert stopped.done < 8
    standing = [head.epoch for name in ("fixed", "mass") for head in resume.standing(tmp_path, name)]
    assert standing
    assert all(0 < epoch < 12 for epoch in standing)
    (other,) = engines.values()
    ended = sweep(study(), tmp_path, engine=other, simulate=toy)
    assert stopped.done + ended.done == 8
    assert content(tmp_path) == whole[0]
    assert list((tmp_path / CHECKPOINTS).iterdir()) == []


def test_robots_move_alike_on_workers_and_here(tmp_path, pair):
    small = load_config(ROOT / "configs/smoke.yaml", ["learning.epochs=12", "trial.duration=0.5"], "0..2")
    sweep(small, tmp_path / "here")
    sweep(small, tmp_path / "there", engine=nullcontext(replace(pair, simulate=simulate)))
    assert content(tmp_path / "there") == content(tmp_path / "here")


# --- progress ------------------------------------------------------------------------------------------------------


def test_what_workers_tell_adds_up_to_what_one_process_tells(tmp_path, whole, pair):
    told = []
    sweep(study(), tmp_path, engine=nullcontext(pair), progress=told.append)
    last, expected = told[-1], whole[1][-1]
    assert (last.diverged, last.refined, last.done) == (expected.diverged, expected.refined, 8)
    assert (last.fraction, last.remaining) == (1.0, 0.0)
    fractions = [each.fraction for each in told]
    assert fractions == sorted(fractions)


@given(st.data())
def test_work_done_twice_counts_once(data):
    """A job of 40 epochs of 100 lane-steps and 3 diverged trials each; checkpoints, deaths and messages at random."""
    effort, beats = Effort(job=FakeJob()), []
    started = checkpoint = data.draw(st.integers(0, 20))
    deaths = data.draw(st.integers(0, 4))
    for attempt in range(deaths + 1):
        begun = checkpoint
        end = 40 if attempt == deaths else data.draw(st.integers(begun, 39))
        heard = sorted({begun, *data.draw(st.lists(st.integers(begun, end))), *([40] if attempt == deaths else [])})
        for epoch in heard:
            done = epoch - begun
            message = {"epoch": epoch, "epochs": 40, "skipped": 100 * begun, "work": 100 * done}
            beats.append(effort.beat(message | {"diverged": 3 * done, "refined": 0}))
        if attempt < deaths:
            checkpoint = data.draw(st.integers(begun, heard[-1]))
            effort.lose("host")
    assert sum(beat.skipped for beat in beats) == 100 * started
    assert sum(beat.work for beat in beats) == 100 * (40 - started)
    assert sum(beat.diverged for beat in beats) == 3 * (40 - started)


class FakeJob:
    group = Group("fixed", (0,))


def test_a_job_is_not_tried_again_on_the_host_that_it_was_lost_on_if_there_is_another():
    """A host on which every worker dies must not be the end of all jobs."""
    dispatch = Dispatch(None, toy, 1, False, SAID.append, [FakeJob()], SAID.append, bool)
    dispatch._workers = {"tls://bad:1": 1, "tls://good:1": 1, "tls://good:2": 1}
    (lost,) = dispatch._again = deque([dispatch._next("tls://bad:1")])
    lost.lose("bad")
    assert dispatch._next("tls://bad:1") is None
    assert dispatch._next("tls://good:2") is lost
    dispatch._again.append(lost)
    dispatch._workers = {"tls://bad:2": 1}
    assert dispatch._next("tls://bad:2") is lost


# --- lost workers --------------------------------------------------------------------------------------------------


def test_a_killed_worker_costs_what_it_had_not_saved(tmp_path, whole, pair):
    """CR-15, the short form."""
    SAID.clear()
    told, victims = [], pids(pair)

    def kill_one(progress):
        told.append(progress)
        if progress.kind == "epoch" and victims:
            os.kill(victims.pop(), signal.SIGKILL)
            victims.clear()

    outcome = sweep(study(), tmp_path, engine=nullcontext(pair), progress=kill_one, checkpoint=EVERY_EPOCH)
    assert (outcome.done, outcome.failed) == (8, 0)
    assert content(tmp_path) == whole[0]
    assert told[-1].fraction == 1.0
    assert len(SAID) == 1
    assert "its worker was lost; it goes on from its last checkpoint" in SAID[0]
    assert within(30, lambda: len(pids(pair)) == 2)


def test_a_run_that_always_kills_its_worker_fails_after_three_and_the_others_do_not(tmp_path, whole, pair):
    deaths = tmp_path / "deaths"
    deaths.mkdir()

    def poison(body, behaviours, *, morphology, **settings):
        if morphology.mass != 1.0:
            (deaths / str(os.getpid())).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return toy(body, behaviours, morphology=morphology, **settings)

    told = []
    outcome = sweep(
        study(seeds="0"), tmp_path / "out", engine=nullcontext(replace(pair, simulate=poison)), progress=told.append
    )
    assert (outcome.done, outcome.failed, outcome.stopped) == (1, 1, False)
    assert len(list(deaths.iterdir())) == 3
    (failure,) = read_manifest(tmp_path / "out").failures.values()
    assert failure.startswith("it killed its worker three times")
    (said,) = [each.message for each in told if each.kind == "failure"]
    assert said.endswith(failure)
    assert told[-1].fraction == 1.0
    assert content(tmp_path / "out").items() <= whole[0].items()
    assert sweep(study(seeds="0"), tmp_path / "out", simulate=toy).done == 1
    assert content(tmp_path / "out").keys() <= whole[0].keys()


def test_workers_do_not_see_signals_meant_for_the_process_that_started_them(tmp_path, whole, pair):
    assert within(30, lambda: len(pids(pair)) == 2)  # one may just be starting again
    before, sent = pids(pair), []

    def signal_all(progress):
        if progress.kind == "epoch" and not sent:
            sent.extend((signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
            for pid in before:
                for number in sent:
                    os.kill(pid, number)

    assert sweep(study(), tmp_path, engine=nullcontext(pair), progress=signal_all).done == 8
    assert sent
    assert sorted(pids(pair)) == sorted(before)
    assert content(tmp_path) == whole[0]


SCRIPT = """
import os, sys
from contextlib import nullcontext
from study.toy import slow_toy, study
from wobblesim.commands.stopping import stop_on_signals
from wobblesim.study.engines.cluster import cluster
from wobblesim.study.execute import sweep

def say(told):
    if told.kind == "epoch":
        print("epoch", flush=True)

with cluster(2, 1, simulate=slow_toy(0.1)) as engine, stop_on_signals(lambda: None, lambda: None) as stop:
    print(*engine.client.run(os.getpid).values(), flush=True)
    outcome = sweep(study(), sys.argv[1], engine=nullcontext(engine), progress=say, stop=stop)
sys.exit(4 if outcome.stopped else 0)
"""


@pytest.fixture
def alone(tmp_path):
    """A sweep in a process group of its own, in an empty folder, once its first epoch is done; and its workers."""
    here, scratch = tmp_path / "here", tmp_path / "scratch"
    here.mkdir()
    scratch.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(tmp_path / "out")],
        cwd=here,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "TMPDIR": str(scratch)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        workers = [int(word) for word in process.stdout.readline().split()]
        assert process.stdout.readline() == "epoch\n"
        yield process, workers
        process.kill()


def gone(workers):
    return all(not psutil.pid_exists(pid) or psutil.Process(pid).status() == "zombie" for pid in workers)


def test_workers_end_with_the_process_that_started_them_and_its_work_goes_on(tmp_path, whole, alone):
    process, workers = alone
    assert len(workers) == 2
    process.kill()
    assert within(5, lambda: gone(workers))
    sweep(study(), tmp_path / "out", simulate=toy)
    assert content(tmp_path / "out") == whole[0]


def test_ctrl_c_in_a_terminal_stops_with_checkpoints_and_leaves_nothing_behind(tmp_path, whole, alone):
    process, workers = alone
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    asked = time.monotonic()
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 4
    assert time.monotonic() - asked < 10
    assert errors == ""
    assert gone(workers)
    assert [*(tmp_path / "here").iterdir(), *(tmp_path / "scratch").iterdir()] == []
    assert {head.epoch > 0 for name in ("fixed", "mass") for head in resume.standing(tmp_path / "out", name)} == {True}
    sweep(study(), tmp_path / "out", simulate=toy)
    assert content(tmp_path / "out") == whole[0]


@pytest.mark.nightly
def test_a_sweep_survives_two_minutes_of_dying_workers(tmp_path):
    """CR-15: a worker is killed every 4 s for 2 min; the groups of one condition kill theirs whatever happens."""

    def task(body, behaviours, *, morphology, **settings):
        if abs(morphology.mass - 1) > 0.25:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.1)
        return toy(body, behaviours, morphology=morphology, **settings)

    harmless = ["conditions.mass.wobble.amplitude=0.2", "learning.epochs=300"]
    poisoned = [*harmless, "conditions.poison={wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 6}}"]
    over, killed, told = threading.Event(), [], []
    with cluster(3, 1, simulate=task) as engine:

        def kill():
            until = time.monotonic() + 120
            while time.monotonic() < until and not over.wait(4):
                if victims := pids(engine):
                    # The oldest: one that has just begun again, again and again, is what a poisoned run looks like.
                    killed.append(min(victims, key=lambda pid: psutil.Process(pid).create_time()))
                    os.kill(killed[-1], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        try:
            outcome = sweep(
                study(*poisoned, seeds="0..39"),
                tmp_path / "out",
                engine=nullcontext(engine),
                progress=told.append,
                checkpoint=EVERY_EPOCH,
            )
        finally:
            over.set()
            killer.join()
    assert len(killed) >= 12  # measured 28
    assert (outcome.done, outcome.failed, outcome.stopped) == (80, 40, False)
    assert {condition for condition, _ in read_manifest(tmp_path / "out").failures} == {"poison"}
    assert told[-1].fraction == 1.0
    sweep(study(*harmless, seeds="0..39"), tmp_path / "whole", simulate=toy)
    assert content(tmp_path / "out") == content(tmp_path / "whole")


# --- what cannot be computed ---------------------------------------------------------------------------------------


def test_a_worker_with_another_simulator_is_refused_in_one_sentence(tmp_path, pair, monkeypatch):
    monkeypatch.setattr(execute, "kernel_hash", lambda: "another")
    with pytest.raises(StoreError, match=r"^a worker has another simulator \(kernel .* instead of another\); give"):
        sweep(study(), tmp_path, engine=nullcontext(pair))


def test_a_worker_that_cannot_write_ends_the_sweep_and_the_others_save_what_they_have(tmp_path, whole, pair):
    (tmp_path / CHECKPOINTS).mkdir()
    (tmp_path / CHECKPOINTS / "condition=mass").touch()  # where a folder should be
    with pytest.raises(StoreError, match=r"^cannot write .*condition=mass.*: (not a directory|file exists)"):
        sweep(study(), tmp_path, engine=nullcontext(pair), checkpoint=EVERY_EPOCH)
    (tmp_path / CHECKPOINTS / "condition=mass").unlink()
    assert sweep(study(), tmp_path, simulate=toy).done + 0 <= 8
    assert content(tmp_path) == whole[0]


def test_a_task_that_workers_cannot_load_is_refused_in_one_sentence(tmp_path, pair):
    with pytest.raises(StoreError, match=r"^the worker tls://127\.0\.0\.1:\d+ cannot compute \(.*no_such_module"):
        sweep(study(), tmp_path, engine=nullcontext(replace(pair, simulate=Unloadable())))


class Unloadable:
    def __call__(self, *_, **__):
        raise AssertionError

    def __reduce__(self):
        return __import__, ("no_such_module",)


# --- kernels -------------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_kernels_are_compiled_by_one_worker_and_loaded_by_the_others(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    small = load_config(ROOT / "configs/smoke.yaml", ["learning.epochs=4", "trial.duration=0.5"], "0..3")
    with cluster(2, 1) as engine:
        sweep(small, tmp_path / "out", engine=nullcontext(engine))
        counted = engine.client.run(misses_and_hits)
    assert sorted(misses > 0 for misses, _ in counted.values()) == [False, True]
    assert all(hits > 0 for misses, hits in counted.values() if not misses)


def misses_and_hits():
    from wobblesim.physics.simulate import advance

    return sum(advance.stats.cache_misses.values()), sum(advance.stats.cache_hits.values())
