"""Stopped, killed, gone on: the same rows as if nothing had happened."""

import numpy as np
import pytest
from study.toy import StopAfter, content, study, toy

from wobblesim.study import resume
from wobblesim.study.execute import sweep
from wobblesim.study.store import CHECKPOINTS
from wobblesim.study.work import Interval


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The content of the study that was never disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    sweep(study(), folder, simulate=toy)
    return content(folder)


@pytest.mark.parametrize("epochs", [0, 1, 5, 6, 11, 12, 13, 20])
def test_a_stopped_sweep_goes_on_with_the_same_bits(tmp_path, whole, epochs):
    # The question is asked once before each group and once after each epoch.
    stopped = sweep(study(), tmp_path, simulate=toy, stop=StopAfter(epochs))
    assert stopped.stopped
    outcome = sweep(study(), tmp_path, simulate=toy)
    assert stopped.done + outcome.done == 8
    assert not outcome.stopped
    assert content(tmp_path) == whole


def test_stopping_after_every_epoch_changes_nothing(tmp_path, whole):
    stops = 0
    while sweep(study(), tmp_path, simulate=toy, stop=StopAfter(1)).stopped:
        stops += 1
    # 12 epochs in each of two groups; the last of a group ends it instead of stopping it.
    assert stops == 2 * 11 + 1
    assert content(tmp_path) == whole


def test_a_stopped_group_does_not_repeat_its_epochs(tmp_path):
    calls = []

    def counting(*arguments, **settings):
        calls.append(1)
        return toy(*arguments, **settings)

    sweep(study(), tmp_path, simulate=counting, stop=StopAfter(7))
    sweep(study(), tmp_path, simulate=counting)
    assert len(calls) == 24


def test_frequent_checkpoints_change_nothing_and_leave_nothing(tmp_path, whole):
    sweep(study(), tmp_path, simulate=toy, checkpoint=Interval(seconds=0.0))
    assert content(tmp_path) == whole
    assert list((tmp_path / CHECKPOINTS).iterdir()) == []


def test_groups_of_other_sizes_give_the_same_rows(tmp_path, whole):
    for seeds in ("3", "0..1", "0..3"):
        sweep(study(seeds=seeds), tmp_path, simulate=toy)
    assert content(tmp_path) == whole


def test_a_checkpoint_with_seeds_that_are_not_wanted_now_is_kept_for_later(tmp_path, whole):
    sweep(study(), tmp_path, simulate=toy, stop=StopAfter(7))
    assert sweep(study(seeds="0..1"), tmp_path, simulate=toy).done == 4
    (head,) = resume.standing(tmp_path, "fixed")
    assert (head.group.seeds, head.epoch) == ((0, 1, 2, 3), 7)
    assert sweep(study(), tmp_path, simulate=toy).done == 4
    assert content(tmp_path) == whole


@pytest.mark.parametrize("file", ["state.npz", "part-0.npz"])
@pytest.mark.parametrize("damage", ["cut", "flip", "gone", "empty"])
def test_a_damaged_checkpoint_is_named_and_its_runs_start_anew(tmp_path, whole, file, damage):
    sweep(study(), tmp_path, simulate=toy, stop=StopAfter(7))
    (path,) = tmp_path.glob(f"{CHECKPOINTS}/*/*/{file}")
    bits = bytearray(path.read_bytes())
    if damage == "gone":
        path.unlink()
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "cut":
        path.write_bytes(bits[: len(bits) // 2])
    else:
        bits[len(bits) // 3] ^= 16
        path.write_bytes(bits)
    said = []
    sweep(study(), tmp_path, simulate=toy, progress=said.append)
    assert any("cannot be read: its runs start anew" in told.message for told in said)
    assert content(tmp_path) == whole


def test_a_checkpoint_holds_no_pickle(tmp_path):
    sweep(study(), tmp_path, simulate=toy, stop=StopAfter(3))
    for path in tmp_path.glob(f"{CHECKPOINTS}/*/*/*.npz"):
        with np.load(path, allow_pickle=False) as archive:
            assert all(archive[name].dtype != object for name in archive)


def test_a_crash_between_the_runs_of_a_group_repeats_none_of_them(tmp_path, whole, monkeypatch):
    from wobblesim.study.store import Store

    commit = Store.commit

    def dying(store, lines):
        commit(store, lines[:2])  # as if the system had written no more of the lines
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Store, "commit", dying)
        with pytest.raises(KeyboardInterrupt):
            sweep(study(), tmp_path, simulate=toy, checkpoint=Interval(seconds=0.0))
    outcome = sweep(study(), tmp_path, simulate=toy)
    assert (outcome.present, outcome.done) == (2, 6)
    assert content(tmp_path) == whole


def test_a_checkpoint_is_of_its_seeds_only(tmp_path):
    # As many seeds, the same first one: the others must not get what seeds 1, 2 and 3 have learnt.
    sweep(study(seeds="0..3"), tmp_path / "both", simulate=toy, stop=StopAfter(5))
    sweep(study(seeds="0,2,4,6"), tmp_path / "both", simulate=toy)
    sweep(study(seeds="0,2,4,6"), tmp_path / "fresh", simulate=toy)
    wanted = content(tmp_path / "fresh")
    assert content(tmp_path / "both") == wanted


def test_a_checkpoint_is_of_its_settings_only(tmp_path):
    # The manifest that would have refused the change is lost.
    sweep(study(), tmp_path / "both", simulate=toy, stop=StopAfter(5))
    (tmp_path / "both" / "manifest.jsonl").unlink()
    sweep(study("learning.scale=0.3"), tmp_path / "both", simulate=toy)
    sweep(study("learning.scale=0.3"), tmp_path / "fresh", simulate=toy)
    assert content(tmp_path / "both") == content(tmp_path / "fresh")
