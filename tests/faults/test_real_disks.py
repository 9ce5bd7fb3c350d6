"""Real file systems that are full (CR-4), read-only, not ours or gone (CR-5), through the command line."""

import os
import re
import subprocess
import tempfile
import time
from pathlib import Path

import pytest
from faults import children
from faults.children import started
from faults.scenarios import check_sound, read
from study.toy import study, toy

from wobblesim.config import dump
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import MANIFEST

SIZE = r"[\d.]+ (bytes|kB|MB)"
NO_ROOM = rf"cannot write \S+: no space left on device \({SIZE} needed, {SIZE} free\); make room .* again"

IS_ROOT = os.geteuid() == 0
NEEDS_ROOT = pytest.mark.skipif(not IS_ROOT, reason="only root may do this")

BIG = ("learning.epochs=50", "log=behaviours")
"""A run of 60 kB."""


def big(seeds="0..19"):
    return study(*BIG, seeds=seeds)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The rows of the study that nothing disturbs."""
    folder = tmp_path_factory.mktemp("whole")
    sweep(big(), folder, simulate=toy)
    return read(folder)[0]


@pytest.fixture
def place():
    """A folder that every user can reach."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture
def disk(place):
    """A disk of 8 MB of its own."""
    mount = place / "disk"
    mount.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=8m,mode=777", "none", mount]
    mounted = subprocess.run(command, check=False, capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"mounting is not allowed here: {mounted.stderr.strip()}")
    yield mount
    subprocess.run(["umount", "-l", mount], check=True)


@pytest.fixture
def command(place):
    """Gives a sweep command; returns exit code, what it says on stderr, and the seconds it took."""
    (place / "study.yaml").write_text(dump(big()))

    def give(out, *functions):
        arguments = ["sweep", str(place / "study.yaml"), "--out", str(out), "--progress", "none"]
        process = started(children.command, arguments, place, *functions)
        began = time.monotonic()
        process.join(120)
        process.kill()
        return process.exitcode, (place / "stderr").read_text(), time.monotonic() - began

    yield give
    assert "Traceback" not in (place / "stderr").read_text()


def remounted(disk, options):
    subprocess.run(["mount", "-o", f"remount,{options}", disk], check=True)


def fill(file):
    """Write for ever."""
    while True:
        file.write(bytes(4096))


def check_goes_on(command, folder, wanted):
    """The same command ends well, and with the rows of a sweep that nothing disturbed."""
    assert command(folder)[0] == 0
    check_sound(folder, wanted)


def test_a_disk_of_8_mb_fills_up_and_is_told_with_path_and_need_and_the_sweep_goes_on(disk, command, whole, injected):
    folder = disk / "results"
    (disk / "ballast").write_bytes(bytes(6_300_000))
    code, said, seconds = command(folder)
    assert (code, bool(re.fullmatch(NO_ROOM, said.strip()))) == (1, True), said
    assert seconds < 10.0  # measured 3, of which all but 0.1 computing what fits
    rows, runs = read(folder)
    assert 0 < len(runs) < 40
    assert f"cannot write {folder}" in said
    before = (folder / MANIFEST).read_bytes()
    code, again, _ = command(folder)  # still no room
    assert code == 1
    assert re.fullmatch(NO_ROOM, again.strip()), again
    assert (folder / MANIFEST).read_bytes() == before
    assert read(folder) == (rows, runs)
    remounted(disk, "size=64m")
    check_goes_on(command, folder, whole)
    injected("real disk full", 2)


def test_a_disk_that_is_full_from_the_start_is_told_before_anything_is_computed(disk, command, injected):
    with pytest.raises(OSError, match="No space left"), (disk / "ballast").open("wb", buffering=0) as ballast:
        fill(ballast)
    code, said, seconds = command(disk / "results", None, children.sleep_for_ever)
    assert code == 1
    assert re.fullmatch(NO_ROOM, said.strip()), said
    assert seconds < 2.0  # measured 0.2
    injected("real disk full")


def test_a_file_that_may_not_grow_is_told_and_the_sweep_goes_on(tmp_path, command, whole, injected):
    folder = tmp_path / "results"
    code, said, _ = command(folder, children.limit_files)
    assert code == 1
    assert re.fullmatch(r"cannot write \S+: file too large; put that right and give the same command again\n", said)
    check_goes_on(command, folder, whole)
    injected("real limit of the length of a file")


@NEEDS_ROOT
def test_a_read_only_file_system_is_told_before_anything_is_computed(disk, command, injected):
    for folder in (disk / "fresh", disk / "begun"):
        if folder.name == "begun":
            remounted(disk, "rw")
            sweep(big("0"), folder, simulate=toy)
        remounted(disk, "ro")
        code, said, seconds = command(folder, None, children.sleep_for_ever)
        assert code == 2
        assert said == f"cannot write to {folder}: read-only file system; choose another folder with --out\n"
        assert seconds < 2.0  # measured 0.2
    injected("real read-only file system", 2)


@NEEDS_ROOT
def test_a_folder_of_somebody_else_is_told_before_anything_is_computed(disk, command, injected):
    folder = disk / "results"
    sweep(big("0"), folder, simulate=toy)
    code, said, seconds = command(folder, children.become_nobody, children.sleep_for_ever)
    assert code == 2
    assert said == f"cannot write to {folder}: permission denied; choose another folder with --out\n"
    assert seconds < 2.0  # measured 0.2
    injected("real lack of permission")


@NEEDS_ROOT
def test_a_folder_that_is_protected_meanwhile_is_told_and_the_sweep_goes_on(disk, command, whole, injected):
    folder = disk / "results"
    remounted(disk, "size=64m")
    code, said, _ = command(folder, children.become_nobody, children.protect_later, folder)
    assert code == 1
    assert re.fullmatch(r"cannot write \S+: permission denied; put that right and give the same command again\n", said)
    assert len(read(folder)[1]) > 0
    check_goes_on(command, folder, whole)
    injected("real lack of permission")


def test_a_folder_that_is_removed_meanwhile_is_told_and_the_command_starts_anew(tmp_path, command, whole, injected):
    folder = tmp_path / "results"
    code, said, _ = command(folder, None, children.remove_later, folder)
    assert code == 1
    assert re.fullmatch(r"cannot write \S+: no such file or directory; put that right and give .* again\n", said), said
    assert not folder.exists()
    check_goes_on(command, folder, whole)
    injected("folder removed meanwhile")


def test_a_folder_that_is_no_folder_is_refused_before_anything_is_computed(tmp_path, command, injected):
    (tmp_path / "file").write_text("in the way")
    folder = tmp_path / "file" / "deeper"
    code, said, seconds = command(folder, None, children.sleep_for_ever)
    assert (code, seconds < 2.0) == (2, True)  # measured 0.2
    assert said == f"cannot write to {folder}: not a directory; choose another folder with --out\n"
    injected("folder that cannot be")
