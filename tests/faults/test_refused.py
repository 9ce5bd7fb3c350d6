"""The system refuses a call: the disk is full (CR-4), or broken, read-only or gone (CR-5)."""

import errno
import re
import shutil
import time

import pytest
from faults.disk import CHANGES, Disk, fail_at
from faults.scenarios import RESULTS, check_recovers, chosen, note, read, recorded

from wobblesim.study.errors import StoreError, WriteError

TAKING = frozenset(("open", "write", "fsync", "mkdir", "link", "replace"))
"""Calls that may need room."""

NAMING = frozenset(("open", "truncate", "replace", "mkdir", "rmdir", "unlink", "link"))
"""Calls that need the permission to write."""

REFUSALS = {
    "the disk is full": (errno.ENOSPC, TAKING, True),
    "the disk is full for a moment": (errno.ENOSPC, TAKING, False),
    "the quota is used up": (errno.EDQUOT, TAKING, True),
    "input/output error of a call": (errno.EIO, frozenset((*CHANGES, "read")), False),
    "input/output errors from a call on": (errno.EIO, frozenset((*CHANGES, "read")), True),
    "the file system is read-only from a call on": (errno.EROFS, NAMING, True),
    "permission denied from a call on": (errno.EACCES, NAMING, True),
}


def check_refusals(tmp_path, scenario, injected, kind):
    """Refuse each call of a scenario in turn; it ends in one sentence, harms nothing, and can be gone on with."""
    code, kinds, forever = REFUSALS[kind]
    disk, wanted = recorded(scenario, tmp_path / "whole")
    before, folder, said = read(tmp_path / "origin" / RESULTS)[1], tmp_path / "refused", []
    points = [number for number, call in enumerate(disk.tried, 1) if call.kind in kinds]
    for point in points:
        shutil.copytree(tmp_path / "origin", folder)
        began = time.monotonic()
        with Disk(folder, fail_at(point, code, kinds, forever=forever)) as failing:
            try:
                scenario.act(folder, lambda told: note(failing, folder, told))
            except StoreError as error:
                said.append(error)
        assert time.monotonic() - began < 10.0  # measured 0.04
        told = [call.more[0] for call in failing.calls if call.kind == "mark"]
        check_recovers(scenario, folder, wanted, before.union(*told))
        shutil.rmtree(folder)
    assert all(str(folder) in str(error) and "\n" not in str(error) for error in said)
    injected(f"injected: {kind}", len(points))
    return said, len(points)


TOLD = re.compile(
    r"cannot write \S+: [\w ]+ \([\d.]+ (bytes|kB) needed, [\d.]+ ([kMG]B|bytes) free\); make room .* again"
)


def check_no_room(tmp_path, scenario, injected, kind):
    """All that needs room ends with what it is for, how much it is and how much there is."""
    said, points = check_refusals(tmp_path, scenario, injected, kind)
    assert len(said) == points
    assert all(isinstance(error, WriteError) and TOLD.fullmatch(str(error)) for error in said)


@pytest.mark.parametrize("scenario", chosen("commit", "checkpoints", "take in shards"), indirect=True)
def test_a_full_disk_is_told_with_path_and_need_and_harms_nothing(tmp_path, scenario, injected):  # CR-4
    check_no_room(tmp_path, scenario, injected, "the disk is full")


@pytest.mark.parametrize("scenario", chosen("commit"), indirect=True)
def test_an_input_output_error_is_told_in_a_sentence_and_harms_nothing(tmp_path, scenario, injected):  # CR-5
    check_refusals(tmp_path, scenario, injected, "input/output error of a call")


@pytest.mark.parametrize("scenario", chosen("checkpoints"), indirect=True)
def test_a_file_system_that_turns_read_only_is_told_in_a_sentence_and_harms_nothing(tmp_path, scenario, injected):
    check_refusals(tmp_path, scenario, injected, "the file system is read-only from a call on")


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["the disk is full", "the quota is used up"])
def test_no_room_in_all_scenarios(tmp_path, scenario, injected, kind):  # CR-4
    check_no_room(tmp_path, scenario, injected, kind)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "kind", [kind for kind in REFUSALS if kind not in ("the disk is full", "the quota is used up")]
)
def test_refusals_in_all_scenarios(tmp_path, scenario, injected, kind):  # CR-5
    check_refusals(tmp_path, scenario, injected, kind)
