"""Every file says what computed it: settings, versions, commit, processor."""

import json
import os
import subprocess
import time
from pathlib import Path

import llvmlite
import numba
import numpy as np
import pyarrow as pa
import pytest
from llvmlite import binding
from study.toy import TABLES, study, toy

from wobblesim.config import Parameters, expand, load_config
from wobblesim.physics import kernels
from wobblesim.study import provenance as module
from wobblesim.study.execute import sweep
from wobblesim.study.files import read_about
from wobblesim.study.manifest import read_manifest
from wobblesim.study.provenance import git_state, provenance, vector_features, without_places

ROOT = Path(__file__).parents[2]


# --- settings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted((ROOT / "configs").rglob("*.yaml")), ids=lambda path: path.stem)
def test_settings_come_back_from_json_as_they_were(path):
    for condition in expand(load_config(path)):
        written = json.dumps(condition.parameters.model_dump(mode="json"))
        assert Parameters.model_validate(json.loads(written)) == condition.parameters, condition.id


def test_settings_with_every_number_at_its_last_bit_come_back(tmp_path):
    third = 1.0 / 3.0
    config = study(f"physics.dt={third / 10!r}", f"learning.scale={third!r}", "scene.gravity=[0.1, -99.7]")
    parameters = expand(config)[0].parameters
    again = Parameters.model_validate_json(json.dumps(parameters.model_dump(mode="json")))
    assert (again.physics.dt, again.learning.scale) == (third / 10, third)
    assert again == parameters


# --- what a file says ----------------------------------------------------------------------------------------------


def test_each_file_of_a_run_says_what_computed_it(tmp_path):
    sweep(study(seeds="3"), tmp_path, simulate=toy)
    settings = {condition.id: condition.parameters for condition in expand(study())}
    for table in TABLES:
        for file in read_manifest(tmp_path).files(table):
            about = read_about(tmp_path / file.path)
            assert Parameters.model_validate(json.loads(about.pop("config"))) == settings[about["condition"]]
            own = {"table": table, "condition": about["condition"], "seed": "3"}
            assert about == own | {"schema_version": about["schema_version"]} | provenance()


def test_the_versions_are_those_of_the_modules_at_work():
    said = provenance()
    modules = {"numba": numba, "llvmlite": llvmlite, "numpy": np, "pyarrow": pa}
    assert {name: said[name] for name in modules} == {name: made.__version__ for name, made in modules.items()}


def test_the_processor_is_what_the_kernels_are_compiled_for(monkeypatch):
    said, host = provenance(), binding.get_host_cpu_features()
    assert said["target"] == kernels.processor()
    assert said["features"].split() == vector_features()
    assert all(host[name] for name in vector_features())
    assert ("fma" in vector_features()) == bool(host.get("fma"))
    monkeypatch.setattr(numba.config, "CPU_FEATURES", "+sse4.2,+avx2,-avx512f,+popcnt")
    assert vector_features() == ["avx2", "sse4.2"]


def test_provenance_is_found_out_once():
    assert provenance() is provenance()


# --- the commit ----------------------------------------------------------------------------------------------------

ALONE = {"GIT_CONFIG_NOSYSTEM": "1", "GIT_CONFIG_GLOBAL": os.devnull}
WHO = ["-c", "user.name=Nobody", "-c", "user.email=nobody@example.org"]


def git(folder: Path, *arguments: str) -> str:
    command = ["git", *WHO, *arguments]
    return subprocess.run(
        command, cwd=folder, env=os.environ | ALONE, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.fixture(params=["sha1", "sha256"])
def package(request, tmp_path):
    """A package of two files, at the head of a repository."""
    package = tmp_path / "checkout" / "package"
    (package / "part").mkdir(parents=True)
    (package / "__init__.py").write_text("one = 1\n")
    (package / "part" / "größe.py").write_text("two = 2\n")
    (package.parent / "README").write_text("words\n")
    git(package.parent, "init", "-q", f"--object-format={request.param}")
    git(package.parent, "add", ".")
    git(package.parent, "commit", "-q", "-m", "all")
    return package


def test_an_unchanged_package_is_its_commit(package):
    head = git(package.parent, "rev-parse", "HEAD")
    assert git_state(package) == head
    os.utime(package / "__init__.py", (0, 0))
    (package.parent / "README").write_text("other words\n")
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "x.pyc").write_bytes(b"\0")
    (package / "notes.txt").write_text("not code\n")
    assert git_state(package) == head


CHANGES = {
    "a changed file": lambda package: (package / "__init__.py").write_text("one = 2\n"),
    "a staged file": lambda package: (
        (package / "__init__.py").write_text("one = 2\n"),
        git(package.parent, "add", "."),
    ),
    "a new file": lambda package: (package / "new.py").write_text("three = 3\n"),
    "a removed file": lambda package: (package / "part" / "größe.py").unlink(),
    "a file that git ignores": lambda package: (
        (package / ".gitignore").write_text("new.py\n"),
        (package / "new.py").write_text("three = 3\n"),
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_package_is_dirty(package, change):
    head = git(package.parent, "rev-parse", "HEAD")
    CHANGES[change](package)
    assert git_state(package) == f"{head}-dirty"


def test_what_is_no_checkout_of_the_package_has_no_commit(package, tmp_path, monkeypatch):
    inside = package.parent / "env" / "package"  # an environment within the checkout of something else
    inside.mkdir(parents=True)
    outside = tmp_path / "elsewhere" / "package"
    outside.mkdir(parents=True)
    assert git_state(inside) == git_state(outside) == ""
    (outside.parent / ".git").write_text("gitdir: /nowhere\n")
    assert git_state(outside) == ""
    (outside.parent / ".git").unlink()
    git(outside.parent, "init", "-q")
    assert git_state(outside) == ""  # no commit yet
    monkeypatch.setenv("PATH", str(tmp_path))
    assert git_state(package) == ""  # no git


def test_a_second_worktree_has_its_own_commit(package, tmp_path):
    git(package.parent, "worktree", "add", "-q", str(tmp_path / "second"))
    assert git_state(tmp_path / "second" / "package") == git(package.parent, "rev-parse", "HEAD")


def test_git_runs_nothing_that_anybody_has_configured(package, tmp_path, monkeypatch):
    head, marker = git(package.parent, "rev-parse", "HEAD"), tmp_path / "marker"
    bait = tmp_path / "bait"
    bait.write_text(f"#!/bin/sh\ntouch {marker}\ncat\n")
    bait.chmod(0o755)
    hooks = tmp_path / "hooks"
    hooks.mkdir()
    for name in ("post-index-change", "post-checkout", "reference-transaction", "pre-auto-gc"):
        (hooks / name).write_text(bait.read_text())
        (hooks / name).chmod(0o755)
    settings = {
        "core.fsmonitor": bait, "core.hooksPath": hooks, "filter.x.clean": bait, "filter.x.smudge": bait,
        "filter.x.process": bait, "diff.external": bait, "core.pager": bait, "pager.rev-parse": bait,
        "alias.rev-parse": f"!{bait}", "core.sshCommand": bait, "core.editor": bait, "credential.helper": f"!{bait}",
    }  # fmt: skip
    (package.parent / ".gitattributes").write_text("* filter=x diff=x\n")
    home = tmp_path / "home"
    home.mkdir()
    for key, value in settings.items():
        git(package.parent, "config", "--local", key, str(value))
        git(home, "config", "--file", str(home / ".gitconfig"), key, str(value))
    monkeypatch.setenv("HOME", str(home))
    for name in ("GIT_EXTERNAL_DIFF", "GIT_SSH_COMMAND", "GIT_PAGER", "GIT_EDITOR"):
        monkeypatch.setenv(name, str(bait))
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "another"))  # as in a hook of another repository
    monkeypatch.setenv("GIT_INDEX_FILE", str(tmp_path / "index"))
    (package.parent / ".git" / "index.lock").touch()
    before = sorted(path.name for path in (package.parent / ".git").iterdir())
    assert git_state(package) == head
    assert not marker.exists()
    assert sorted(path.name for path in (package.parent / ".git").iterdir()) == before
    # The bait is a live one: what does read the files' state runs it.
    (package.parent / ".git" / "index.lock").unlink()
    for name in ("GIT_DIR", "GIT_INDEX_FILE"):
        monkeypatch.delenv(name)
    subprocess.run(["git", "status"], cwd=package.parent, capture_output=True, check=False)
    assert marker.exists()


@pytest.mark.parametrize(
    "script", ["exec sleep 30", "sleep 30 & exec sleep 30", "exit 3", "echo; exit 0", "kill -9 $$"]
)
def test_a_git_that_hangs_or_fails_costs_no_more_than_its_patience(package, tmp_path, monkeypatch, script):
    fake = tmp_path / "bin"
    fake.mkdir()
    (fake / "git").write_text(f"#!/bin/sh\n{script}\n")
    (fake / "git").chmod(0o755)
    monkeypatch.setenv("PATH", str(fake), prepend=os.pathsep)
    monkeypatch.setattr(module, "GIT_PATIENCE", 0.2)
    begun = time.perf_counter()
    assert git_state(package) == ""
    assert time.perf_counter() - begun < 2.0  # measured 0.21 s


def test_the_commit_is_found_out_quickly():
    # Processor time of this process and of git, which other processes on the machine do not change much.
    before = sum(os.times()[:4])
    for _ in range(20):
        git_state()
    assert (sum(os.times()[:4]) - before) / 20 < 0.05  # measured 0.006 s


def test_this_checkout_says_its_own_commit():
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout")
    assert git_state().removesuffix("-dirty") == git(ROOT, "rev-parse", "HEAD")


# --- nothing of who or where ---------------------------------------------------------------------------------------


def test_a_traceback_loses_the_folders_of_this_machine(monkeypatch):
    monkeypatch.setenv("HOME", "/somewhere/alice")
    text = f'File "{module.__file__}", line 1\nFile "{np.__file__}"\nFile "/somewhere/alice/study/task.py"\nat /x/y'
    told = without_places(text)
    assert told.splitlines()[0] == 'File "wobblesim/study/provenance.py", line 1'
    assert told.splitlines()[1] in ('File "lib/numpy/__init__.py"', 'File "numpy/__init__.py"')
    assert told.splitlines()[2:] == ['File "~/study/task.py"', "at /x/y"]
