"""Compiled kernels on disk: none is stale, torn or another user's. CR-11, DT-8, SE-7."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from wobblesim.physics import kernels

ROOT = Path(__file__).parents[2]
KEY, KERNEL = ("float32", "rocketlake"), {"code": b"\x90" * 1000}


@pytest.fixture
def files(tmp_path):
    return kernels._Files(tmp_path, "midpoint.step-7.py311", stamp=b"source")


def saved(files) -> Path:
    files.save(KEY, KERNEL)
    (path,) = files._folder.iterdir()
    return path


# --- one file -----------------------------------------------------------------------------------------------------


def test_a_kernel_comes_back_and_is_its_keys(files):
    path = saved(files)
    assert files.load(KEY) == KERNEL
    assert files.load(("float64", "rocketlake")) is None
    assert kernels._Files(files._folder, files._name, b"another source").load(KEY) is None
    path.rename(files._path("another key"))  # as if two keys had one hash
    assert files.load("another key") is None


DAMAGES = {
    "empty": lambda content: b"",
    "40 bytes": lambda content: content[:40],
    "last byte lost": lambda content: content[:-1],
    "one bit": lambda content: content[:500] + bytes([content[500] ^ 1]) + content[501:],
    "garbage": lambda content: np.random.default_rng(0).bytes(len(content)),
    "zeros": lambda content: bytes(len(content)),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_noticed_and_replaced(files, damage):
    path = saved(files)
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    with pytest.warns(RuntimeWarning, match="damaged kernels"):
        assert files.load(KEY) is None
    files.save(KEY, KERNEL)
    assert files.load(KEY) == KERNEL


def test_two_processes_that_compile_at_once_leave_both_kernels(files):
    other = kernels._Files(files._folder, files._name, b"source")
    assert files.load(KEY) is None
    assert other.load("another key") is None  # both know an empty folder
    files.save(KEY, KERNEL)
    other.save("another key", "another kernel")
    assert (files.load(KEY), files.load("another key")) == (KERNEL, "another kernel")


def test_a_disk_that_takes_nothing_is_a_warning(files):
    files._path(KEY).mkdir()
    with pytest.warns(RuntimeWarning, match="kernels are not cached"):
        files.save(KEY, KERNEL)
    assert list(files._folder.iterdir()) == [files._path(KEY)]  # nothing half written is left


def test_a_file_of_another_user_is_not_read(files, monkeypatch):
    path = saved(files)
    monkeypatch.setattr(kernels, "_user", lambda: path.stat().st_uid + 1)
    assert files.load(KEY) is None


# --- the folder ---------------------------------------------------------------------------------------------------


@pytest.fixture
def base(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def test_the_folder_is_private_also_where_all_may_write(base):
    base.chmod(0o777)
    folder = kernels._usable_folder()
    assert folder is not None
    assert folder.parent == base
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777, 0o720])
def test_a_folder_that_others_can_write_to_is_not_used(base, mode):
    kernels.cache_folder().mkdir()
    kernels.cache_folder().chmod(mode)
    with pytest.warns(RuntimeWarning, match="others may write"):
        assert kernels._usable_folder() is None


def test_a_folder_of_another_user_is_not_used(base, monkeypatch):
    monkeypatch.setattr(kernels, "_user", lambda: base.stat().st_uid + 1)
    with pytest.warns(RuntimeWarning, match="others may write"):
        assert kernels._usable_folder() is None


def test_a_folder_that_cannot_be_made_is_a_warning(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    with pytest.warns(RuntimeWarning, match="kernels are not cached"):
        assert kernels._usable_folder() is None


def test_a_kernel_runs_where_nothing_can_be_kept(base):
    kernels.cache_folder().touch()  # a file where the folder should be

    @kernels.kernel
    def twice(x):
        return x + x

    with pytest.warns(RuntimeWarning, match="kernels are not cached"):
        assert twice(2.0) == 4.0


def test_the_folder_says_version_kernels_and_processor(monkeypatch):
    import wobblesim

    name = kernels.cache_folder().name
    assert name.endswith(f"{wobblesim.__version__}-{kernels.kernel_hash()}-{kernels.processor()}")
    names = {name}
    for cpu, features in (("haswell", ""), ("haswell", "+avx512f"), ("generic", "")):
        monkeypatch.setattr(numba.config, "CPU_NAME", cpu)
        monkeypatch.setattr(numba.config, "CPU_FEATURES", features)
        assert kernels.processor().startswith(f"{cpu}-")
        names.add(kernels.cache_folder().name)
    assert len(names) == 4


# --- whole processes ----------------------------------------------------------------------------------------------

SIMULATE = """
import sys; sys.path[:0] = [".", "tests"]
import dataclasses, hashlib, json, os
import numba, numpy
import wobblesim as ws
from scenes import still, triangle
from wobblesim.physics.simulate import advance

# Thrown apart in free flight, motors off: little to compile, and yet the springs decide where it ends.
body = dataclasses.replace(triangle(), velocity=numpy.random.default_rng(0).normal(size=(3, 2)))
physics = ws.Physics(integrator="explicit", dt=5e-4, precision="float64")
scene = ws.Scene(gravity=0.0, floor=None)
trials = ws.simulate(body, still(body), scene=scene, physics=physics, duration=0.5)
assert numba.config.CACHE_DIR == os.environ["NUMBA_CACHE_DIR"]  # the setting of the process is left alone
print(json.dumps([hashlib.sha256(trials.displacement).hexdigest(), sum(advance.stats.cache_misses.values())]))
"""


def simulate(folder: Path, root: Path) -> tuple[str, int, str]:
    """Hash of the results of a fresh process, how many kernels it did not find on disk, and what it warned of."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder)}
    command = [sys.executable, "-P", "-c", SIMULATE]
    found = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=True)
    return (*json.loads(found.stdout), found.stderr)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A copy of the project, a folder of the kernels that a fresh process has compiled there, and what came of it."""
    root, folder = tmp_path_factory.mktemp("project"), tmp_path_factory.mktemp("kernels")
    for name in ("wobblesim", "tests"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    return root, folder, simulate(folder, root)


def test_damaged_kernels_are_compiled_anew_with_one_warning_and_the_same_bits(compiled, tmp_path):  # CR-11
    root, whole, cold = compiled
    assert cold[1:] == (1, "")
    folder = tmp_path / "damaged"
    shutil.copytree(whole, folder)
    for i, path in enumerate(sorted(folder.rglob("*.nbc"))):
        path.write_bytes(list(DAMAGES.values())[i % len(DAMAGES)](path.read_bytes()))
    for path in folder.rglob("simulate.advance*.nbc"):
        path.write_bytes(path.read_bytes()[:40])
    digest, misses, warned = simulate(folder, root)
    assert (digest, misses) == (cold[0], 1)
    assert warned.count("RuntimeWarning: damaged kernels") == 1
    assert simulate(folder, root) == (cold[0], 0, "")


def test_a_changed_constant_in_an_imported_module_changes_the_result(compiled):  # DT-8
    root, folder, first = compiled
    contract = root / "wobblesim" / "physics" / "contract.py"
    source = contract.read_text(encoding="utf-8")
    changed, n = re.subn(r"(?m)^CLOSEST = .*$", "CLOSEST = 99.99", source)  # u: the springs lose their directions
    assert n == 1
    times = contract.stat().st_atime_ns, contract.stat().st_mtime_ns
    contract.write_text(changed, encoding="utf-8")
    os.utime(contract, ns=times)  # nothing but the content tells
    second = simulate(folder, root)
    assert second[0] != first[0]
    assert second[1] == 1
    contract.write_text(source, encoding="utf-8")
    assert simulate(folder, root) == (first[0], 0, "")  # the old kernels are still there
