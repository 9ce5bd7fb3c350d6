"""Order of convergence: one spring against its closed form, a small network against the matrix exponential."""

import numpy as np
import pytest
from measures import slope
from reference.scipy_reference import damped_oscillator, small_motion
from scenes import LENGTH, oscillators, random_body, still

import wobblesim as ws

SPACE = ws.Scene(gravity=0.0, floor=None)


def simulate(body, integrator, dt, duration, record_every=1):
    physics = ws.Physics(integrator=integrator, dt=dt, precision="float64")
    trials = ws.simulate(body, still(body), scene=SPACE, physics=physics, duration=duration, record_every=record_every)
    return trials.positions[:, :, :, 0]


@pytest.mark.parametrize("damping_ratio", [0.0, 0.3])
@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_error_of_one_spring_falls_with_the_registered_order(integrator, damping_ratio):  # SD-1
    omega, duration = 10.0, 5.0
    body = oscillators(omega, [damping_ratio])
    steps, errors = 0.02 * 0.5 ** np.arange(7), []
    for j, dt in enumerate(steps):
        x = simulate(body, integrator, dt, duration, record_every=2**j)[:, 1, 0] - LENGTH
        exact = damped_oscillator(1.0, omega, damping_ratio, np.linspace(0, duration, len(x)))
        errors.append(np.abs(x - exact).max())
    # The author's law damps so much that only its finest pair of steps is in the asymptotic range.
    # Measured 0.95 and 1.00 (impulse), 2.00 and 2.00, 4.00 and 3.95.
    assert slope(steps[-2:], errors[-2:]) == pytest.approx(ws.INTEGRATORS[integrator].order, abs=0.1)


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_small_motion_converges_to_the_matrix_exponential(integrator):  # SD-2
    built = random_body(21, nodes=10, springs=20, muscles=0, fixed=0)
    rng = np.random.default_rng(22)
    displacement = 1e-6 * LENGTH * rng.normal(size=(10, 2))
    # Soft and lightly damped, so that all modes still swing after a second and no error drowns in rounding.
    options = {"mass": built.mass, "stiffness": built.stiffness / 4, "damping_ratio": built.damping_ratio / 20}
    resting = ws.Body.from_arrays(built.position, built.springs, **options)
    moved = ws.Body.from_arrays(
        built.position + displacement, built.springs, rest_length=resting.rest_length, **options
    )
    exact = small_motion(resting, displacement, np.array([1.0]))[0]
    order = ws.INTEGRATORS[integrator].order
    finest = 1 / {1: 16000, 2: 4000}.get(order, 800)
    coarse, middle, fine = (
        simulate(moved, integrator, dt, 1.0, round(1 / dt))[-1] - built.position
        for dt in (4 * finest, 2 * finest, finest)
    )
    scale = np.abs(displacement).max()
    # measured 1.93, 4.006, 17.1
    ratio = np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine)
    assert ratio == pytest.approx(2**order, rel=0.15)
    # Two extrapolations, of order p and p + 1; what is left is the curvature that the linear reference leaves out.
    finer, coarser = (b + (b - a) / (2**order - 1) for a, b in ((middle, fine), (coarse, middle)))
    limit = finer + (finer - coarser) / (2 ** (order + 1) - 1)
    assert np.abs(limit - exact).max() < 1e-5 * scale  # measured 8.6e-6 (impulse), 2.5e-6, 2.4e-6
