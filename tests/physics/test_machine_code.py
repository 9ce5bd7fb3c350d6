"""What the compiler makes of the kernels: no contraction to fused multiply-adds, no fast-math."""

import json
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest
from llvmlite.binding import get_host_cpu_features

ROOT = Path(__file__).parents[2]

# x86: vfmadd213ps, vfnmsub231ss; ARM: fmla, fmls, fmadd, fnmsub. A whole instruction, at the start of its line.
FUSED = re.compile(r"^\s+(v?fn?m(?:add|sub)\w*|fml[as]\w*)\b", re.MULTILINE)
DIVISION = re.compile(r"^\s+(v?divp[sd]|fdiv)\b", re.MULTILINE)  # of lanes: a sign that this is the step's code

# A kernel loaded from the disk cache has no assembly to show: this runs in a process with an empty cache. The control
# is compiled with what the kernels must not have.
COMPILE = """
import sys; sys.path[:0] = [".", "tests"]
import json
import numba
import wobblesim as ws
from scenes import random_behaviours, triangle
from wobblesim.physics import simulate

physics = ws.Physics(integrator="midpoint", precision="float32")
ws.simulate(triangle(), random_behaviours(0, 16, 2), physics=physics, duration=0.1, width=16)
control = numba.njit("float64(float64, float64, float64)", fastmath=True)(lambda a, b, c: a * b + c)
print(json.dumps([list(kernel.inspect_asm().values()) for kernel in (simulate.advance, control)]))
"""


@pytest.fixture(scope="module")
def assembly(tmp_path_factory):
    """Assembly of `advance` for midpoint in float32, and of a contracted multiplication and addition."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("kernels"))}
    printed = subprocess.run(
        [sys.executable, "-c", COMPILE], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout
    return json.loads(printed)


def test_no_multiplication_and_addition_are_fused(assembly):
    (kernel,), _ = assembly
    assert len(DIVISION.findall(kernel)) >= 2  # 1/d of each spring, 1/det of each node
    assert FUSED.findall(kernel) == []


def test_this_test_would_see_a_fused_instruction(assembly):
    _, (control,) = assembly
    if platform.machine() not in ("arm64", "aarch64") and not get_host_cpu_features().get("fma"):
        pytest.skip("this processor has no fused multiply-add")
    assert FUSED.findall(control)


def test_no_source_asks_for_fast_math():
    sources = list((ROOT / "wobblesim").rglob("*.py"))
    assert len(sources) > 20
    assert not [path for path in sources if "fastmath" in path.read_text(encoding="utf-8")]
