"""The same bits alone, in any batch, in any lane, with any number of threads, in any process."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import random_behaviours, triangle

import wobblesim as ws

ROOT = Path(__file__).parents[2]
PRECISIONS = ["float32", "float64"]
INTEGRATORS = {"impulse": 0.005, "midpoint": 0.01, "explicit": 5e-4}


def simulate(behaviours, integrator, precision, threads=None):
    physics = ws.Physics(integrator=integrator, dt=INTEGRATORS[integrator], precision=precision)
    trials = ws.simulate(triangle(), behaviours, physics=physics, duration=0.5, record_every=10, threads=threads)
    return trials.positions, trials.displacement


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_same_bits_in_any_batch_and_lane(integrator, precision):  # DT-3
    behaviours = random_behaviours(1, 1000, 2)
    positions, displacement = simulate(behaviours, integrator, precision)
    for lanes in [range(1), range(3, 10), range(20), range(100, 164), np.random.default_rng(2).permutation(1000)]:
        lanes = np.array(lanes)
        some_positions, some_displacement = simulate(behaviours[lanes], integrator, precision)
        np.testing.assert_array_equal(some_positions, positions[..., lanes])
        np.testing.assert_array_equal(some_displacement, displacement[lanes])


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_same_bits_with_any_number_of_threads(integrator, precision):  # DT-2
    behaviours = random_behaviours(3, 100, 2)
    one, two = (simulate(behaviours, integrator, precision, threads) for threads in (1, 2))
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])


def digest() -> str:
    """SHA-256 of what a fresh process computes."""
    sha = hashlib.sha256()
    for integrator in ("impulse", "midpoint"):
        for array in simulate(random_behaviours(4, 20, 2), integrator, "float64"):
            sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def test_same_bits_in_fresh_processes_with_cold_and_warm_cache(tmp_path):  # DT-1
    code = "import sys; sys.path[:0] = ['.', 'tests', 'tests/physics']; import test_determinism as t; print(t.digest())"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    outputs = [
        subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        ).stdout.strip()
        for _ in range(3)
    ]
    assert any(tmp_path.rglob("*.nbi"))  # the first process compiled, the others loaded
    assert outputs == [digest()] * 3
