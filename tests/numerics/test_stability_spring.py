"""One spring: the theory's limits against closed forms, and the kernels against the theory (ST-1)."""

import math

import numpy as np
import pytest
from scenes import LENGTH, oscillators, still

import wobblesim as ws
from wobblesim.numerics import stability_spring as spring

THETA = ws.Physics().theta


def physics(integrator, **options):
    return ws.Physics(
        **(
            {"integrator": integrator, "dt": 0.01, "precision": "float64", "max_speed": 1e30, "refinements": 0}
            | options
        )
    )


def test_explicit_ends_where_rk4_does():
    # on the imaginary axis |R(is)|² = 1 - s⁶/72 + s⁸/576 passes 1 at s² = 8
    assert spring.theory_limit("explicit", 0.0, THETA) == pytest.approx(2 * math.sqrt(2), rel=2e-5)  # 6e-6 below
    # on the negative real axis R(-s) = 1 at the root of 1 - s/2 + s²/6 - s³/24
    root = np.roots([-1 / 24, 1 / 6, -1 / 2, 1])
    real = float(root[np.abs(root.imag) < 1e-9].real.item())
    assert spring.theory_limit("explicit", 1.0, THETA) == pytest.approx(real, rel=2e-5)  # 2.78529


@pytest.mark.parametrize("zeta", spring.ZETAS)
@pytest.mark.parametrize("theta", [0.5, 0.6, 1.0])
def test_implicit_methods_have_no_limit(theta, zeta):
    assert spring.theory_limit("midpoint", zeta, theta) == math.inf
    assert spring.theory_limit("impulse", zeta, theta) == math.inf


def test_midpoint_below_one_half_has_the_limit_of_its_polynomial():
    # λ = -1 solves λ² - (2 - a) λ + 1 at a = 4: s² = 4 (1 + theta s²/2), s = 2/sqrt(1 - 2 theta)
    assert spring.theory_limit("midpoint", 0.0, 0.4) == pytest.approx(2 / math.sqrt(1 - 2 * 0.4), rel=2e-5)


@pytest.mark.parametrize("s", [0.1, 1.0, 30.0])
def test_radii_are_the_closed_forms(s):
    assert spring.spectral_radius("midpoint", s, 0.0, THETA) == pytest.approx(1.0, abs=1e-12)
    assert spring.spectral_radius("impulse", s, 0.0, THETA) == pytest.approx(1 / math.hypot(1, s), rel=1e-12)
    # critically damped, implicit Euler has the double eigenvalue 1/(1 + s), found to the root of rounding
    assert spring.spectral_radius("impulse", s, 1.0, THETA) == pytest.approx(1 / (1 + s), rel=1e-6)


@pytest.mark.parametrize("zeta", spring.ZETAS)
@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_measured_limit_is_the_theorys(integrator, zeta):
    measured = spring.measured_limit(physics(integrator), zeta)
    theory = spring.theory_limit(integrator, zeta, THETA)
    assert measured == theory or measured == pytest.approx(theory, rel=2e-5)  # 0 to 5e-6


@pytest.mark.parametrize("zeta", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
@pytest.mark.parametrize("s", spring.LADDER[:-1])
def test_every_rung_has_the_theorys_radius(integrator, s, zeta):
    measured = spring.measured_radius(physics(integrator), s, zeta)
    theory = spring.spectral_radius(integrator, s, zeta, THETA)
    assert measured == pytest.approx(theory, rel=2e-6, abs=1e-9)  # 3e-7: a double eigenvalue's root of rounding


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("s", spring.LADDER)
@pytest.mark.parametrize("integrator", ["midpoint", "impulse"])
def test_no_rung_swings_beyond_its_start_in_a_long_run(integrator, s, precision):
    # Undamped, midpoint keeps x² + (1 + (theta/2 - 1/4) s²) w²: released at rest, neither x nor the energy x² + w²
    # passes its start. Implicit Euler loses energy in every step.
    options = physics(integrator, precision=precision)
    body = oscillators(s / options.dt, spring.ZETAS)
    scene = ws.Scene(gravity=0.0, floor=None)
    trials = ws.simulate(body, still(body), scene=scene, physics=options, duration=40.0, record_every=1)
    stretch = trials.positions[:, 1::2, 0, 0] - LENGTH
    assert np.abs(stretch).max() <= 1 + {"float32": 2e-3, "float64": 1e-9}[precision]  # 6e-4, 2e-12


@pytest.mark.parametrize("integrator", ["midpoint", "impulse"])
def test_across_taut_springs_the_limit_is_two(integrator):
    assert spring.theory_limit_across(integrator) == pytest.approx(2.0, rel=2e-5)  # 5e-6 below
    assert spring.measured_limit_across(physics(integrator)) == pytest.approx(2.0, rel=3e-4)  # 4e-5, 1e-5 above


def test_explicit_refuses_what_it_can_see():
    body = ws.Body.from_arrays([(0, 0), (1, 0)], [(0, 1)], stiffness=1e6, damping_ratio=0.0, fixed=[True, False])
    limit = spring.theory_limit("explicit", 0.0, THETA) / 1e3
    options = {"scene": ws.Scene(gravity=0.0, floor=None), "duration": 0.1}
    ws.simulate(body, np.zeros((1, 0)), physics=physics("explicit", dt=0.999 * limit), **options)
    with pytest.raises(ValueError, match="unstable"):
        ws.simulate(body, np.zeros((1, 0)), physics=physics("explicit", dt=1.001 * limit), **options)
