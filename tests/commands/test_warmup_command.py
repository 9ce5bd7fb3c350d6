"""`wobblesim warmup`: after it a sweep compiles nothing, and a second one finds all there."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from wobblesim.commands import main
from wobblesim.physics import kernels

ROOT = Path(__file__).parents[2]
OPTIONS = ["--integrator", "explicit", "--precision", "float64"]

TRY = """
import numpy as np
import wobblesim as ws
from wobblesim.physics.simulate import advance

physics = ws.Physics(integrator="explicit", precision="float64", dt=2e-4)
for trials in (1, 3, 15, 20, 60):
    ws.simulate(ws.starfish(), np.ones((trials, 24)), physics=physics, duration=0.001)
print(sum(advance.stats.cache_misses.values()))
"""


@pytest.fixture
def python(tmp_path):
    """Runs Python in the project with kernels of its own."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        return subprocess.run(
            [sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        )

    return run


def test_after_it_trials_compile_nothing_and_a_second_one_finds_all_there(python, tmp_path):
    first = python("cli.py", "warmup", *OPTIONS, "--json")
    told = json.loads(first.stdout)
    assert [(kernel["width"], kernel["compiled"]) for kernel in told["kernels"]] == [(8, True), (4, True), (2, True)]
    assert Path(told["folder"]).parent == tmp_path
    assert told["bytes"] == sum(path.stat().st_size for path in tmp_path.rglob("*.nbc")) > 100_000
    assert len(first.stderr.splitlines()) == 3
    assert "explicit float64, floor, 8 lanes: compiled in" in first.stderr

    assert python("-c", TRY).stdout.strip() == "0"

    second = python("cli.py", "warmup", *OPTIONS)
    assert second.stdout.startswith("3 kernels: 0 compiled, 3 were there; ")
    assert told["folder"] in second.stdout
    assert second.stderr.count("there already, loaded in") == 3


@pytest.mark.parametrize("options", [["--integrator", "euler"], ["--precision", "float16"], ["--everything"]])
def test_options_that_mean_nothing_are_refused(options):
    result = CliRunner().invoke(main, ["warmup", *options])
    assert result.exit_code == 2
    assert result.stdout == ""


def test_without_a_folder_it_says_so(monkeypatch):
    monkeypatch.setattr(kernels, "FOLDER", None)
    result = CliRunner().invoke(main, ["warmup"])
    assert (result.exit_code, result.stdout) == (1, "")
    assert "cannot be kept" in result.stderr
