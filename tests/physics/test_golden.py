"""One hash of a moving robot for each integrator and precision, the same on every processor: DT-5 and DT-7.

`golden.json` holds them. When a change of results is meant, run
``pytest tests/physics/test_golden.py --golden-update``, which rewrites the file, and say in CHANGELOG.md under
**Results** what changed and why.
"""

import ctypes
import ctypes.util
import hashlib
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features
from scenes import random_behaviours

import wobblesim as ws

ROOT = Path(__file__).parents[2]
GOLDEN = Path(__file__).with_name("golden.json")
SETTINGS = {
    "midpoint": (ws.Physics(integrator="midpoint").dt, 10.0),  # step and duration, s
    "impulse": (0.005, 10.0),
    "explicit": (2e-4, 2.0),
}
CASES = [f"{integrator} {precision}" for integrator in SETTINGS for precision in ("float32", "float64")]
FRAMES = 20


def digest(case: str, behaviours: np.ndarray | None = None) -> str:
    """SHA-256 of 20 frames of the default robot, and of what came of it, under 4 random behaviours."""
    integrator, precision = case.split()
    dt, duration = SETTINGS[integrator]
    trials = ws.simulate(
        ws.starfish(),
        random_behaviours(0, 4, 12) if behaviours is None else behaviours,
        physics=ws.Physics(integrator=integrator, dt=dt, precision=precision),
        duration=duration,
        record_every=round(duration / dt / FRAMES),
        width=4,
        threads=1,
    )
    sha = hashlib.sha256(" ".join(trials.status).encode())
    for array in (trials.positions, trials.displacement, trials.limited):
        sha.update(np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes())
    return sha.hexdigest()


def golden() -> dict[str, str]:
    return json.loads(GOLDEN.read_text(encoding="utf-8"))


@pytest.fixture(scope="session", autouse=True)
def _update(request):
    if request.config.getoption("--golden-update"):
        GOLDEN.write_text(json.dumps({case: digest(case) for case in CASES}, indent=2) + "\n", encoding="utf-8")


@pytest.mark.parametrize("case", CASES)
def test_the_default_robot_moves_as_committed(case):
    assert digest(case) == golden()[case], "results changed: see this file's first lines"


def test_the_hash_feels_the_last_bit_of_one_amplitude():
    behaviours = random_behaviours(0, 4, 12)
    assert digest("midpoint float64", behaviours) == golden()["midpoint float64"]
    behaviours[3, 0] = np.nextafter(behaviours[3, 0], 1)
    assert digest("midpoint float64", behaviours) != golden()["midpoint float64"]


# --- other processors -------------------------------------------------------------------------------------------------

X86 = platform.machine().lower() in ("x86_64", "amd64")
NEEDS = {"generic": "sse2", "haswell": "avx2", "skylake-avx512": "avx512f"}  # to run what was compiled for a processor


def start(code: str, **environment: str) -> subprocess.Popen[str]:
    """A fresh process that knows this module as `t` and prints JSON."""
    code = f"import sys, json; sys.path[:0] = ['.', 'tests', 'tests/physics']; import test_golden as t; {code}"
    return subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, env=os.environ | environment, stdout=subprocess.PIPE, text=True
    )


def result(process: subprocess.Popen[str]):
    printed, _ = process.communicate()
    assert process.returncode == 0
    return json.loads(printed)


def compiled_for(processor: str, cases: list[str], folder: Path, **environment: str) -> subprocess.Popen[str]:
    """Digests by a process that compiles for another processor (its features as well: Numba would take ours)."""
    told = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(folder)}
    code = f"from wobblesim.physics import kernels; print(json.dumps([kernels.processor(), *map(t.digest, {cases!r})]))"
    return start(code, **told, **environment)


def check(processor: str, cases: list[str], process: subprocess.Popen[str]) -> None:
    told, *found = result(process)
    assert told.startswith(f"{processor}-")
    assert found == [golden()[case] for case in cases]


def runnable() -> list[str]:
    features = get_host_cpu_features()
    return [processor for processor, feature in NEEDS.items() if X86 and features.get(feature)]


def test_code_for_other_processors_has_the_same_bits(tmp_path):
    cases = ["midpoint float32"]
    running = {name: compiled_for(name, cases, tmp_path) for name in runnable()}  # side by side
    for name, process in running.items():
        check(name, cases, process)
    assert len(list(tmp_path.iterdir())) == len(running)  # each has a cache folder of its own


@pytest.mark.nightly
@pytest.mark.parametrize("processor", NEEDS)
def test_code_for_other_processors_has_the_same_bits_by_every_method(tmp_path, processor):
    if processor not in runnable():
        pytest.skip(f"this processor cannot run code for {processor}")
    check(processor, CASES, compiled_for(processor, CASES, tmp_path))


def plainer_cpu() -> dict[str, str]:
    """Environment in which NumPy and the C library choose the code they have for an older processor.

    Both are told by the names of features, the C library's of before and after version 2.33.
    """
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    disabled = [name for name in __cpu_dispatch__ if __cpu_features__.get(name)]
    hwcaps = "-AVX2_Usable,-AVX2,-FMA_Usable,-FMA,-FMA4,-AVX512F,-AVX512VL"
    return {"NPY_DISABLE_CPU_FEATURES": " ".join(disabled), "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={hwcaps}"}


@pytest.mark.nightly  # a fused multiply-add without the instruction takes the C library 0.3 us
def test_a_processor_without_fused_instructions_has_the_same_bits(tmp_path):
    if "generic" not in runnable():
        pytest.skip("generic is a name of x86 here")
    cases = ["midpoint float32"]
    check("generic", cases, compiled_for("generic", cases, tmp_path, **plainer_cpu()))


def libraries() -> list[str]:
    """Hashes of a million actuation values by our sine, of the C library's sine and NumPy's exponential, of `CASES`."""
    from wobblesim.robot.gait import cos_turns, sin_turns

    turns = np.random.default_rng(0).uniform(0, 60, 1_000_000)
    ours = np.stack([sin_turns(turns), cos_turns(turns)])
    libm = ctypes.CDLL(ctypes.util.find_library("m"))
    libm.sin.restype, libm.sin.argtypes = ctypes.c_double, [ctypes.c_double]
    theirs = np.array([libm.sin(x) for x in turns[:100_000]])
    arrays = (ours, theirs, np.exp(turns))
    return [*(hashlib.sha256(array.tobytes()).hexdigest() for array in arrays), *map(digest, CASES)]


def test_bits_do_not_depend_on_what_numpy_and_the_c_library_choose():
    if not X86 or platform.libc_ver()[0] != "glibc":
        pytest.skip("only the C library of GNU, on x86, is told to be plainer this way")
    processes = [start("print(json.dumps(t.libraries()))", **told) for told in ({}, plainer_cpu())]
    (ours, libm, numpy, *host), (same, plain_libm, plain_numpy, *plain) = map(result, processes)
    assert ours == same
    assert host == plain == [golden()[case] for case in CASES]
    if get_host_cpu_features().get("avx512f"):  # the switches do something
        assert libm != plain_libm
        assert numpy != plain_numpy
