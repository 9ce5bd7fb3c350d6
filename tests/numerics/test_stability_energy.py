"""The energy by which a cell is judged, against closed forms and another way to compute it."""

import math

import measures
import numpy as np
import pytest
from scenes import oscillators, still

import wobblesim as ws
from wobblesim.numerics import stability_energy as energies

GRAVITY = (0.0, -100.0)


def test_energy_of_one_node_and_one_spring():
    body = ws.Body.from_arrays([(0, 2), (3, 2)], [(0, 1)], stiffness=50.0, rest_length=2.0, mass=2.0)
    v = np.array([[[0.0, 0.0], [4.0, 3.0]]])
    x = np.array([[[0.0, 2.0], [3.0, -0.5]]])
    stretch = math.hypot(3.0, 2.5) - 2.0
    expected = 0.5 * 2 * 25 + 0.5 * 50 * stretch**2 + 2 * 100 * (2.0 - 0.5)
    assert energies.energy(body, x, v, GRAVITY, None)[0] == pytest.approx(expected, rel=1e-14)
    pressed = 0.5 * 20_000.0 * 2 * 0.25
    assert energies.energy(body, x, v, GRAVITY, ws.Floor(stiffness=20_000.0))[0] == pytest.approx(
        expected + pressed, rel=1e-14
    )


@pytest.mark.parametrize("integrator", ["midpoint", "impulse"])
def test_velocities_are_the_methods_own(integrator):
    rng = np.random.default_rng(0)
    x, start = rng.normal(size=(50, 3, 2)).cumsum(axis=0), rng.normal(size=(3, 2))
    np.testing.assert_allclose(
        energies.velocities(integrator, x, start, 0.01), measures.velocities(integrator, x, start, 0.01), atol=1e-9
    )


def test_explicits_velocities_are_not_guessed():
    with pytest.raises(ValueError, match="do not follow"):
        energies.velocities("explicit", np.zeros((3, 1, 2)), np.zeros((1, 2)), 0.01)


def test_undamped_oscillator_keeps_what_the_method_keeps():
    # midpoint swings undamped between x² + w² of its start and the other axis of its ellipse
    omega, dt, theta = 50.0, 0.01, 0.6
    body = oscillators(omega, [0.0])
    physics = ws.Physics(dt=dt, theta=theta, precision="float64", refinements=0)
    scene = ws.Scene(gravity=0.0, floor=None)
    trials = ws.simulate(body, still(body), scene=scene, physics=physics, duration=5.0, record_every=1)
    x = trials.positions[..., 0]
    v = energies.velocities("midpoint", x, body.velocity, dt)
    found = energies.energy(body, x, v, (0.0, 0.0), None)
    assert energies.above_start(found) < 1e-9  # 3e-13
    lowest = 1 / (1 + (theta / 2 - 0.25) * (omega * dt) ** 2)
    assert found.min() / found[0] == pytest.approx(lowest, rel=1e-4)  # 3e-6


def test_a_made_up_series_gains_what_was_put_in():
    series = np.array([10.0, 8.0, 9.0, 11.0, 7.0, 9.5])
    assert energies.above_start(series) == pytest.approx(0.1)
    assert energies.largest_rise(series) == pytest.approx(0.3)
    assert energies.above_start(-series[::-1]) == pytest.approx(2.5 / 9.5)
    for bad in (np.nan, np.inf):
        assert energies.above_start(np.append(series, bad)) == math.inf


def test_a_drop_starts_with_its_weight_and_loses_energy():
    body = ws.starfish()
    physics = ws.Physics(precision="float64", refinements=0)
    found = energies.energy_of_a_drop(body, ws.Morphology(), physics, 3.0)
    start = energies.dropped(body)
    assert start.position[:, 1].min() == pytest.approx(energies.HEIGHT)
    assert found[0] == pytest.approx(100.0 * (body.mass * start.position[:, 1]).sum(), rel=1e-12)
    assert energies.above_start(found) < 0.005  # 2e-5
    assert found[-1] < 0.9 * found[0]  # 0.80


def test_impulse_gains_energy_on_a_light_robot():
    physics = ws.Physics(integrator="impulse", refinements=0)
    found = energies.energy_of_a_drop(ws.starfish(), ws.Morphology(mass=0.05), physics, 3.0)
    assert energies.above_start(found) > 1.0  # 11 to 21


def test_gravity_is_a_part_of_the_morphology():
    body, physics = ws.starfish(), ws.Physics(precision="float64", refinements=0)
    once, twice = (energies.energy_of_a_drop(body, ws.Morphology(gravity=g), physics, 0.1)[0] for g in (1.0, 2.0))
    assert twice == pytest.approx(2 * once)
