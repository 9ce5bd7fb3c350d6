"""`wobblesim warmup`: after it a sweep compiles nothing, and a second one finds all there."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from wobblesim.commands import main
from wobblesim.physics import kernels
from wobblesim.physics.scene import Physics
from wobblesim.physics.simulate import simulate
from wobblesim.robot.starfish import starfish

ROOT = Path(__file__).parents[2]
OPTIONS = ["--integrator", "impulse", "--precision", "float32"]

TRY = """
import sys; sys.path[:0] = ["tests/commands"]
import numpy as np
import wobblesim as ws
from test_warmup_command import PHYSICS, walked
from wobblesim.physics.simulate import advance

for trials in (1, 3, 15, 20, 60):
    ws.simulate(ws.starfish(), np.ones((trials, 24)), physics=PHYSICS, duration=0.01)
print(walked(), sum(advance.stats.cache_misses.values()))
"""
PHYSICS = Physics(integrator="impulse", precision="float32", dt=0.005)


def walked() -> str:
    """Where the starfish is after a tenth of a second, to the last bit."""
    return simulate(starfish(), np.ones((1, 24)), physics=PHYSICS, duration=0.1, width=8).displacement[0].hex()


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
    assert [(kernel["width"], kernel["compiled"]) for kernel in told["kernels"]] == [(32, True), (16, True), (8, True)]
    assert Path(told["folder"]).parent == tmp_path
    assert told["bytes"] == sum(path.stat().st_size for path in tmp_path.rglob("*.nbc")) > 100_000
    assert len(first.stderr.splitlines()) == 3
    assert "impulse float32, floor, 32 lanes: compiled in" in first.stderr

    with ThreadPoolExecutor() as pool:  # at once: both only read
        trials, second = pool.map(lambda arguments: python(*arguments), [("-c", TRY), ("cli.py", "warmup", *OPTIONS)])
    assert trials.stdout.split() == [walked(), "0"]  # with kernels of another process, the bits of this one's own
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
