"""What the compiler makes of the kernels: no fast-math, and no fused multiply-add that the source does not ask for.

A multiplication and an addition that the compiler contracts to one instruction round once on processors that have it
and twice on others. A fused multiply-add that is asked for by name rounds once everywhere.
"""

import json
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest
from llvmlite.binding import get_host_cpu_features

from wobblesim.physics.kernels import kernel
from wobblesim.physics.lanes import load, store

ROOT = Path(__file__).parents[2]
X86 = platform.machine().lower() in ("x86_64", "amd64")

# x86: vfmadd213ps, vfnmsub231ss; ARM: fmla, fmls, fmadd, fnmsub. A whole instruction, at the start of its line.
FUSED = re.compile(r"^\s+(v?fn?m(?:add|sub)\w*|fml[as]\w*)\b(.*)$", re.MULTILINE)
DIVISION = re.compile(r"^\s+(v?divp[sd]|fdiv)\b", re.MULTILINE)  # of lanes: a sign that this is the step's code
ASKED = re.compile(r"\bcall\b[^@\n]*@llvm\.(fma|fmuladd)\.(?:v(\d+))?f(32|64)\(")
# Licences to change the bits: on an instruction, a call or a whole function.
LICENCE = re.compile(r"\b(fast|reassoc|contract|nnan|ninf|nsz|arcp|afn|unsafe-fp-math|denormal-fp-math[\w-]*)\b")
OPERATION = re.compile(r"= (f(?:add|sub|mul|div|neg|cmp)|(?:tail )?call|select|phi)\b(.*)")
REGISTER_BITS = {"x": 128, "y": 256, "z": 512}

# A kernel loaded from the disk cache has no code to show: this runs in a process with an empty cache. The controls: the
# kernels' own decorator on what could be contracted, and on what is fused by name; Numba's with fast-math.
COMPILE = """
import sys; sys.path[:0] = [".", "tests", "tests/physics"]
import json
import numba
import wobblesim as ws
from scenes import random_behaviours, triangle
from test_machine_code import separate
from wobblesim.physics import simulate
from wobblesim.physics.lanes import aligned_zeros, lanes

def code(compiled):
    return compiled.inspect_llvm(compiled.signatures[-1]), compiled.inspect_asm(compiled.signatures[-1])

found = {}
for name, dt in {"midpoint": 0.01, "impulse": 0.005, "explicit": 5e-4}.items():
    physics = ws.Physics(integrator=name, dt=dt, precision="float32")
    ws.simulate(triangle(), random_behaviours(0, 16, 2), physics=physics, duration=0.1, width=16)
    found[name] = code(simulate.advance)
tag = lanes("float32", 16)
separate(tag, aligned_zeros(3, tag))
found["separate"] = code(separate)
fast = numba.njit("float64(float64, float64, float64)", fastmath=True)(lambda a, b, c: a * b + c)
found["fast"] = code(fast)
print(json.dumps(found))
"""


@kernel
def separate(tag, x):
    """Row 0 becomes row 0 times row 1, plus row 2: what a compiler would like to fuse."""
    store(tag, x, 0, load(tag, x, 0) * load(tag, x, 1) + load(tag, x, 2))


KERNELS = ["midpoint", "impulse", "explicit"]


@pytest.fixture(scope="module")
def code(tmp_path_factory):
    """LLVM's intermediate code and assembly of `advance` with each integrator in float32, and of the controls."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("kernels"))}
    printed = subprocess.run(
        [sys.executable, "-c", COMPILE], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout
    return json.loads(printed)


def licences(intermediate):
    """Every licence to change the bits that the compiler was given."""
    operations = [found.group(2) for found in OPERATION.finditer(intermediate)]
    attributes = re.findall(r"^attributes .*$", intermediate, re.MULTILINE)
    return [licence for text in operations + attributes for licence in LICENCE.findall(text)]


def asked(intermediate):
    """Bits of all results of fused multiply-adds that the intermediate code asks for by name."""
    return sum(int(count or 1) * int(size) for _, count, size in ASKED.findall(intermediate))


def fused(assembly):
    """Bits of all results of fused instructions on x86."""
    return sum(_bits(operation, operands) for operation, operands in FUSED.findall(assembly))


def _bits(operation, operands):
    if operation.endswith(("ss", "sd")):
        return 32 if operation.endswith("ss") else 64
    return max(REGISTER_BITS[kind] for kind in re.findall(r"%([xyz])mm", operands))


@pytest.mark.parametrize("name", KERNELS)
def test_no_multiplication_and_addition_are_fused_unasked(code, name):
    intermediate, assembly = code[name]
    assert len(DIVISION.findall(assembly)) >= 2  # at least 1/d of each spring, at two places or more
    assert "@llvm.fmuladd" not in intermediate  # fused or not, as the processor likes
    if not asked(intermediate):
        assert FUSED.findall(assembly) == []
    elif X86:
        assert fused(assembly) <= asked(intermediate)


@pytest.mark.parametrize("name", [*KERNELS, "separate"])
def test_the_compiler_is_given_no_licence_to_change_the_bits(code, name):
    assert len(OPERATION.findall(code[name][0])) >= 2
    assert licences(code[name][0]) == []


def test_the_compiler_does_not_contract_of_its_own_accord(code):
    intermediate, assembly = code["separate"]
    assert re.search(r"fmul <16 x float>", intermediate)
    assert re.search(r"fadd <16 x float>", intermediate)
    assert FUSED.findall(assembly) == []


def test_this_file_would_see_a_licence_and_a_fused_instruction(code):
    intermediate, assembly = code["fast"]
    assert "fast" in licences(intermediate)
    if X86 and not get_host_cpu_features().get("fma"):
        pytest.skip("this processor has no fused multiply-add")
    assert FUSED.findall(assembly)
    assert not X86 or fused(assembly) > asked(intermediate) == 0


def test_no_source_asks_for_fast_math_or_parallel_loops():
    sources = list((ROOT / "wobblesim").rglob("*.py"))
    assert len(sources) > 20
    asks = re.compile(r"fastmath\s*=|\bparallel\s*=|\bimport.*\bprange\b|\bprange\(|vectorize\(|error_model")
    assert not [path for path in sources if asks.search(path.read_text(encoding="utf-8"))]
