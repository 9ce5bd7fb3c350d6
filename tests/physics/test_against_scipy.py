"""Kernels against SciPy's DOP853 on smooth motion: a working triangle in space, and a network of springs."""

from dataclasses import replace

import numpy as np
import pytest
from measures import slope
from reference.scipy_reference import solve
from scenes import random_behaviours, random_body

import wobblesim as ws

GAIT = ws.Gait(period=0.5, max_amplitude=0.2)
SPACE = ws.Scene(gravity=(3.0, -10.0), floor=None)
STEPS = {1: [2e-4, 1e-4, 5e-5], 2: [2e-3, 1e-3, 5e-4], 4: [8e-4, 4e-4, 2e-4]}


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_working_network_converges_to_scipy(integrator):
    body, behaviours, duration = random_body(31), random_behaviours(1, 1, 2), 0.5
    exact = solve(body, behaviours[0], gravity=SPACE.gravity, gait=GAIT, times=np.array([0.0, duration]))[-1, 0]
    order, errors = ws.INTEGRATORS[integrator].order, []
    for dt in STEPS[order]:
        physics = ws.Physics(integrator=integrator, dt=dt, precision="float64")
        trials = ws.simulate(
            body,
            behaviours,
            scene=SPACE,
            physics=physics,
            gait=GAIT,
            duration=duration,
            record_every=round(duration / dt),
        )
        errors.append(np.abs(trials.positions[-1, :, :, 0] - exact).max())
    assert slope(np.array(STEPS[order]), np.array(errors)) == pytest.approx(
        order, abs=0.15
    )  # measured 1.00, 2.00, 4.05


# Through impacts `midpoint` keeps its order; RK4 is up to a step late at each, and its error goes up and down with dt.
@pytest.mark.parametrize(("integrator", "dt", "order"), [("midpoint", 2e-4, 2), ("explicit", 2.5e-5, None)])
def test_falling_network_without_friction_bounces_as_in_scipy(integrator, dt, order):
    fallen = random_body(32, muscles=0, fixed=0)
    body = replace(fallen, friction=np.zeros(fallen.n_nodes))
    scene, duration = ws.Scene(), 0.3
    exact = solve(
        body,
        np.zeros(0),
        gravity=(0.0, -100.0),
        gait=GAIT,
        times=np.array([0.0, duration]),
        floor=scene.floor,
        method="Radau",
        tolerance=1e-8,
    )[-1, 0]
    steps, errors = dt * 0.5 ** np.arange(3 if order else 1), []
    for step in steps:
        physics, n = ws.Physics(integrator=integrator, dt=step, precision="float64"), round(duration / step)
        trials = ws.simulate(body, np.zeros((1, 0)), scene=scene, physics=physics, duration=duration, record_every=n)
        errors.append(np.abs(trials.positions[-1, :, :, 0] - exact).max())
    assert errors[-1] < {"midpoint": 1e-5, "explicit": 1e-4}[integrator]  # u, measured 5.8e-6 and 3.4e-5
    if order:
        assert slope(steps, np.array(errors)) == pytest.approx(order, abs=0.15)  # measured 2.06
