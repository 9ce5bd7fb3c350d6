"""Processes are killed with signal 9 at any time, beside each other and one after the other."""

import fcntl
import itertools
import random
import shutil
import threading
import time

import pytest
from faults import children
from faults.children import started, wait_for
from faults.scenarios import check_sound, read
from study.toy import toy

from wobblesim.study.execute import sweep
from wobblesim.study.lock import Shard, writers
from wobblesim.study.manifest import MANIFEST, read_manifest
from wobblesim.study.store import StoreError, opened
from wobblesim.study.work import Interval

# --- CR-1: at random times -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hundred(tmp_path_factory):
    """The rows of a hundred runs that nothing disturbs."""
    folder = tmp_path_factory.mktemp("hundred")
    sweep(children.hundred(), folder, simulate=toy)
    return read(folder)[0]


@pytest.mark.parametrize("kills", [10, pytest.param(100, marks=pytest.mark.nightly)])
def test_kill_9_at_random_times_loses_nothing_and_redoes_one_group(tmp_path, hundred, injected, kills):
    chance, done, redone, diaries = random.Random(kills), 0, [], itertools.count()
    while done < kills:
        folder, told = tmp_path / "results", set()
        while True:
            diary = tmp_path / f"diary-{next(diaries)}"
            process = started(children.sweep_hundred, folder, diary)
            process.join(chance.uniform(0.05, 0.4))
            was_killed = process.is_alive()
            process.kill()
            process.join()
            events = [line.split(" ", 2) for line in diary.read_text().splitlines()] if diary.exists() else []
            runs = {name for kind, _, name in events if kind == "run"}
            assert not runs & told  # none is computed twice
            assert all(int(present) >= len(told) for _, present, _ in events)  # none is lost
            told |= runs
            if not was_killed:
                assert process.exitcode == 0
                break
            done += 1
            begun = {name for kind, _, name in events if kind == "epoch"}
            stored = {group for group in begun if _first_run(group) in runs}
            redone.append(len(begun - stored))
        assert len(told | {f"{key[0]}, seed {key[1]}" for key in read_manifest(folder).runs}) == 100
        check_sound(folder, hundred)
        shutil.rmtree(folder)
    assert max(redone) <= 1  # the group in flight
    assert max(redone) == 1  # most kills hit one
    injected("kill -9 at a random time of a sweep of 100 runs", done)


def _first_run(group):
    """The first run of a group as it is told of: of ``fixed, seeds 3..7`` it is ``fixed, seed 3``."""
    condition, _, seeds = group.partition(", seed")
    return f"{condition}, seed {seeds.removeprefix('s').strip().partition('..')[0]}"


# --- CR-14: inside a run -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("epochs", "kills"), [(60, 3), pytest.param(400, 10, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("interval", [Interval(seconds=1e9, epochs=7), Interval(seconds=0.05)], ids=["epochs", "time"])
def test_a_kill_inside_a_run_costs_one_checkpoint_interval(tmp_path, injected, epochs, kills, interval):
    sweep(children.long(epochs), tmp_path / "whole", simulate=toy)
    chance, computed = random.Random(epochs), []
    lives = [chance.randrange(8, epochs // kills) for _ in range(kills)]  # epochs that each computes, at most
    for number, deadly in enumerate((*lives, 0)):
        diary = tmp_path / f"diary-{number}"
        process = started(children.sweep_long, tmp_path / "results", diary, epochs, interval, deadly)
        process.join(60)
        computed.append([float(line) for line in diary.read_text().split()])
        if process.exitcode == 0:
            break
        assert process.exitcode == -9
    assert process.exitcode == 0
    deaths = len(computed) - 1
    assert deaths == kills
    check_sound(tmp_path / "results", read(tmp_path / "whole")[0])
    lost = sum(map(len, computed)) - epochs
    if interval.epochs:
        assert deaths <= lost <= deaths * interval.epochs
    else:
        # What was lost took no longer than the interval, and an epoch and the writing of a checkpoint.
        slowest = sorted(max(b - a for a, b in itertools.pairwise(times)) for times in computed)[-1]
        for times in computed[:-1]:
            a_time = (times[-1] - times[0]) / (len(times) - 1)
            assert lost * a_time <= deaths * (interval.seconds + 2 * slowest)
    injected("kill -9 inside a run", deaths)


# --- CR-6: one folder, one process ---------------------------------------------------------------------------------


@pytest.fixture
def holder(tmp_path):
    """Starts processes that hold a folder, or a shard's part of it, and kills them in the end."""
    processes = []

    def hold(folder, shard=None, name=""):
        held = tmp_path / f"held-{len(processes)}"
        processes.append(started(children.hold, folder, held, shard, name))
        wait_for(held.exists, processes[-1])
        return processes[-1]

    yield hold
    for process in processes:
        process.kill()
        process.join()


def refused(folder, shard=None, name=""):
    """What a second process is told, within a second."""
    began = time.monotonic()
    with pytest.raises(StoreError) as told, opened(folder, shard, name):
        pass
    assert time.monotonic() - began < 1.0  # measured 0.52: LOCK_PATIENCE
    return str(told.value)


def test_a_second_process_is_refused_by_name_and_a_killed_one_leaves_no_lock(tmp_path, holder, injected):
    folder = tmp_path / "results"
    first = holder(folder)
    assert f"is in use by process {first.pid} on " in refused(folder)
    assert f"is in use by process {first.pid} on " in refused(folder, Shard(1, 2))
    assert writers(folder)[0].startswith(f"process {first.pid} on ")
    first.kill()
    first.join()
    assert writers(folder) == []
    with opened(folder):
        pass
    injected("second process in a folder", 2)


def test_shards_work_beside_each_other_and_never_twice_on_the_same(tmp_path, holder, injected):
    folder = tmp_path / "results"
    first, second = holder(folder, Shard(1, 3), "this"), holder(folder, Shard(2, 3), "this")
    assert [line.endswith(f"(shard {number}/3)") for number, line in enumerate(writers(folder), 1)] == [True, True]
    assert f"the shard 2/3 of {folder} is in use by " in refused(folder, Shard(2, 3), "this")
    for process in (first, second):
        assert f"process {process.pid} on " in refused(folder)  # the whole of it
    assert "another study or number of shards" in refused(folder, Shard(3, 4), "this")
    assert "another study or number of shards" in refused(folder, Shard(3, 3), "that")
    with opened(folder, Shard(3, 3), "this"):
        pass
    second.kill()
    second.join()
    with opened(folder, Shard(2, 3), "this"):
        pass
    injected("second process in a folder", 5)


def test_a_shard_that_has_not_signed_its_lock_yet_is_no_stranger(tmp_path):
    """Jobs of an array start at the same moment."""
    for left in ("", "process 1 on host\nanother study"):
        folder = tmp_path / f"results-{len(left)}"
        with opened(folder, Shard(1, 3), "this"):
            pass
        path = folder / ".lock-1-of-3"
        path.write_text(left)
        with path.open("r+", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            threading.Timer(0.1, path.write_text, ("process 2 on host\nthis",)).start()
            with opened(folder, Shard(2, 3), "this") as store:
                assert store.shard == Shard(2, 3)


# --- CR-7: many at once --------------------------------------------------------------------------------------------


def test_ten_processes_commit_two_hundred_runs_each_and_all_are_there(tmp_path, injected):
    folder, each = tmp_path / "results", 200
    processes = [started(children.commit_many, folder, Shard(number, 10), each) for number in range(1, 11)]
    for process in processes:
        process.join(120)
    assert [process.exitcode for process in processes] == [0] * 10
    wanted = {("fixed", 1000 * shard + place) for shard in range(1, 11) for place in range(each)}
    assert read_manifest(folder).runs.keys() == wanted
    with opened(folder) as store:
        assert (store.lost, store.manifest.unreadable) == ([], [])
    assert [path.name for path in folder.glob("manifest*")] == [MANIFEST]
    lines = (folder / MANIFEST).read_text().splitlines()
    assert sum('"kind": "run"' in line for line in lines) == 10 * each
    manifest = read_manifest(folder)
    assert manifest.unreadable == []
    assert read(folder)[1] == wanted
    injected("commits of ten processes at once", 10 * each)
