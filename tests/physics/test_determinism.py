"""The same bits alone, in any batch, in any lane, with any number of threads, in any process, for any duration.

Lane width is compared in `test_lanes.py`, processors and libraries in `test_golden.py`, stop and resume of a sweep in
`tests/study/test_resume.py`, of a learner in `tests/learning/test_run.py`, random numbers in `test_streams.py` there.
"""

import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import random_behaviours, small_starfish, triangle

import wobblesim as ws

ROOT = Path(__file__).parents[2]
PRECISIONS = ["float32", "float64"]
INTEGRATORS = {"impulse": 0.005, "midpoint": 0.01, "explicit": 5e-4}


def simulate(behaviours, integrator, precision, **options):
    physics = ws.Physics(integrator=integrator, dt=INTEGRATORS[integrator], precision=precision)
    trials = ws.simulate(triangle(), behaviours, physics=physics, duration=0.5, record_every=10, **options)
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
    behaviours = random_behaviours(3, 200, 2)
    one, *others = (simulate(behaviours, integrator, precision, threads=threads) for threads in (1, 2, 4))
    for other in others:
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.nightly
@pytest.mark.parametrize("threads", [2, 3, 4, 8, 16, 32])
def test_same_bits_of_each_step_and_after_a_minute_with_any_number_of_threads(threads):  # DT-2
    behaviours = random_behaviours(3, 600, 12)
    for duration, record_every in ((160 * ws.Physics().dt, 1), (60.0, None)):
        options = {"duration": duration, "record_every": record_every}
        one = ws.simulate(ws.starfish(), behaviours, threads=1, **options)
        for _ in range(3):
            many = ws.simulate(ws.starfish(), behaviours, threads=threads, **options)
            np.testing.assert_array_equal(many.displacement, one.displacement)
            if record_every:
                np.testing.assert_array_equal(many.positions, one.positions)


def digest() -> str:
    """SHA-256 of what a fresh process computes.

    `explicit` does so in `test_kernel_cache.py`, and `impulse` in `tests/commands/test_warmup_command.py`.
    """
    sha = hashlib.sha256()
    for array in simulate(random_behaviours(4, 20, 2), "midpoint", "float64", width=4):  # one kernel to compile
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def test_same_bits_in_fresh_processes_with_cold_and_warm_cache(tmp_path):  # DT-1
    code = "import sys; sys.path[:0] = ['.', 'tests', 'tests/physics']; import test_determinism as t; print(t.digest())"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def fresh(_=None) -> str:
        command = [sys.executable, "-c", code]
        found = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
        return found.stdout.strip()

    first = fresh()
    kernels = set(tmp_path.rglob("*.nbc"))
    with ThreadPoolExecutor() as pool:
        others = list(pool.map(fresh, range(2)))
    assert kernels == set(tmp_path.rglob("*.nbc")) != set()  # the first process compiled, the others loaded
    assert [first, *others] == [digest()] * 3


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_longer_trial_begins_with_the_bits_of_a_shorter_one(integrator, precision):  # DT-10
    # Nothing that a trial leaves behind, and nothing that depends on its end, reaches another: there is no state to
    # save but the start. The robot lands, sticks and slips on both sides of the cut.
    physics = ws.Physics(integrator=integrator, dt=2e-4 if integrator == "explicit" else 0.005, precision=precision)
    robot, behaviours = small_starfish(), random_behaviours(7, 3, 6)

    def run(steps):
        return ws.simulate(robot, behaviours, physics=physics, duration=steps * physics.dt, record_every=1)

    long = run(337)
    for steps in (1, 37, 160, 237):
        short = run(steps)
        np.testing.assert_array_equal(short.positions, long.positions[: steps + 1])
    again = run(337)  # with others in between
    np.testing.assert_array_equal(again.positions, long.positions)
    np.testing.assert_array_equal(again.displacement, long.displacement)


# What a factor of 1 + 1e-12 on the mass of one node of 108 does to the end point (body lengths) of 16 random
# behaviours in float64: median and largest, measured. It sets how far tests can compare anything but bits.
MOVES = {
    ("midpoint", 5): (2.7e-14, 2.1e-13),
    ("midpoint", 20): (2.1e-6, 9.7e-4),
    ("midpoint", 60): (0.016, 0.27),
    ("impulse", 5): (6.4e-15, 3.6e-14),
    ("impulse", 20): (1.1e-12, 1.2e-7),
    ("impulse", 60): (3.5e-8, 0.083),
}


@pytest.mark.nightly
@pytest.mark.parametrize(("integrator", "duration"), MOVES)
def test_how_a_rounding_error_grows(integrator, duration):  # DT-11
    robot = ws.starfish()
    mass = robot.mass.copy()
    mass[54] *= 1 + 1e-12
    physics = ws.Physics(integrator=integrator, dt=0.01 if integrator == "midpoint" else 0.005, precision="float64")
    ends = [
        ws.simulate(body, random_behaviours(5, 16, 12), physics=physics, duration=duration).displacement
        for body in (robot, replace(robot, mass=mass))
    ]
    move = np.abs(ends[1] - ends[0])
    median, largest = MOVES[integrator, duration]
    print(f"{integrator} after {duration} s: median {np.median(move):.2g}, largest {move.max():.2g} body lengths")
    assert np.all(move > 0)
    assert median / 1e3 < np.median(move) < min(1e3 * median, 0.5)
    assert move.max() < min(1e4 * largest, 2.0)
