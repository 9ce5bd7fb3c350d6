"""What is recorded, and how displacement follows from it."""

import numpy as np
import pytest
from scenes import random_behaviours, small_starfish, triangle

import wobblesim as ws

DT = {"impulse": 0.005, "midpoint": 0.01, "explicit": 5e-4}


def simulate(body, integrator, record_every, precision="float64", steps=100):
    physics = ws.Physics(integrator=integrator, dt=DT[integrator], precision=precision)
    behaviours = random_behaviours(1, 3, body.n_groups)
    return ws.simulate(body, behaviours, physics=physics, duration=steps * physics.dt, record_every=record_every)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("integrator", DT)
def test_displacement_is_that_of_the_centre_in_the_last_frame(integrator, precision):
    body = triangle()
    trials = simulate(body, integrator, 100, precision)
    centre = trials.positions[:, body.center, 0].mean(axis=1)
    expected = (centre[-1] - centre[0]) / body.body_length
    np.testing.assert_allclose(trials.displacement, expected, rtol=0, atol=1e-15 if precision == "float64" else 1e-6)


def test_displacement_is_that_of_the_centre_nodes_only():
    body = small_starfish()
    trials = simulate(body, "midpoint", 100)
    centre = trials.positions[:, :3, 0].mean(axis=1)
    np.testing.assert_allclose(trials.displacement, (centre[-1] - centre[0]) / body.body_length, rtol=0, atol=1e-14)


@pytest.mark.parametrize("integrator", DT)
def test_record_every_counts_steps_and_frame_0_is_the_start(integrator):
    body = triangle()
    every, fifth = simulate(body, integrator, 1), simulate(body, integrator, 5)
    assert every.positions.shape == (101, 3, 2, 3)
    assert fifth.positions.shape == (21, 3, 2, 3)
    np.testing.assert_array_equal(every.positions[0], np.repeat(body.position[..., None], 3, axis=2))
    np.testing.assert_array_equal(fifth.positions, every.positions[::5])


@pytest.mark.parametrize("integrator", DT)
def test_recording_does_not_change_the_bits(integrator):
    body = triangle()
    silent, recorded = simulate(body, integrator, None), simulate(body, integrator, 7)
    assert silent.positions is None
    np.testing.assert_array_equal(silent.displacement, recorded.displacement)
