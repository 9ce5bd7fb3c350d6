"""Energy of an undamped spring, and the ladder of stiffness: no method may create energy from a stretched rest."""

import re

import numpy as np
import pytest
from measures import kinetic_energy, rk4_oscillator_velocities, spring_energy, velocities
from reference.scipy_reference import linearised, longest_rk4_step
from scenes import LENGTH, oscillators, still

import wobblesim as ws

SPACE = ws.Scene(gravity=0.0, floor=None)
OMEGA = 10.0


def energies(integrator, dt, steps, damping_ratio=0.0):
    """Energy at every step, relative to the start, of a spring released from a stretch of 0.1 of its length."""
    body = oscillators(OMEGA, [damping_ratio])
    physics = ws.Physics(integrator=integrator, dt=dt, precision="float64")
    trials = ws.simulate(body, still(body), scene=SPACE, physics=physics, duration=steps * dt, record_every=1)
    x = trials.positions[:, :, :, 0]
    v = velocities(integrator, x, body.velocity, dt)
    if integrator == "explicit":
        v[:-1, 1, 0] = rk4_oscillator_velocities(x[:, 1, 0] - LENGTH, dt, OMEGA, damping_ratio)
    energy = spring_energy(body, x) + kinetic_energy(body, v)
    return energy[np.isfinite(energy)] / energy[0]


@pytest.mark.parametrize("dt", [0.01, 0.001])
@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_undamped_spring_gains_no_energy(integrator, dt):  # SD-5
    assert energies(integrator, dt, round(10 / dt)).max() <= 1 + 1e-9  # measured 0


@pytest.mark.parametrize("dt", [0.01, 0.001])
def test_impulse_loses_energy_as_implicit_euler(dt):  # SD-5
    # Implicit Euler divides the energy by 1 + (omega h)^2 a step: exp(-omega^2 dt T) to first order.
    left = energies("impulse", dt, round(10 / dt))[-1]
    assert left == pytest.approx((1 + (OMEGA * dt) ** 2) ** -round(10 / dt), rel=0.01)  # measured 4.77e-5, 0.3679
    assert left == pytest.approx(np.exp(-(OMEGA**2) * dt * 10), rel=0.06)


@pytest.mark.parametrize("dt", [0.01, 0.001])
def test_midpoint_keeps_its_own_energy(dt):  # SD-5
    # The step has determinant 1 and conserves omega^2 x^2 + (1 + (theta - 1/2) (omega h)^2 / 2) v^2: the energy dips
    # by (theta - 1/2) (omega h)^2 / 2 where the speed is largest, and comes back.
    excess = (ws.Physics().theta - 0.5) * (OMEGA * dt) ** 2 / 2
    energy = energies("midpoint", dt, round(10 / dt))
    assert 1 - energy.min() == pytest.approx(excess / (1 + excess), rel=0.01)
    assert energy.max() == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("dt", [0.01, 0.001])
def test_explicit_loses_energy_with_the_sixth_power_of_the_step(dt):  # SD-5
    # |R(i omega h)|^2 = 1 - (omega h)^6 / 72 + (omega h)^8 / 576 a step.
    a = (OMEGA * dt) ** 2
    steps = round(10 / dt) - 1
    lost = -np.expm1(steps * np.log1p(-(a**3) / 72 + a**4 / 576))
    assert 1 - energies("explicit", dt, steps + 1)[-1] == pytest.approx(lost, rel=0.01, abs=1e-10)


# RK4 is stable on the negative axis to 2.785 (zeta 1: both rates are omega) and on the imaginary one to 2.828 (zeta 0).
REFUSED = {("explicit", w, zeta) for w in (5, 10, 100, 1e4) for zeta in (0.0, 1.0)}


@pytest.mark.parametrize("damping_ratio", [0.0, 1.0])
@pytest.mark.parametrize("omega_dt", [0.1, 0.8, 1, 2, 5, 10, 100, 1e4])
@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_stiff_spring_gains_no_energy_or_is_refused(integrator, omega_dt, damping_ratio):  # ST-1
    if (integrator, omega_dt, damping_ratio) in REFUSED:
        with pytest.raises(ValueError, match="dt"):
            energies(integrator, omega_dt / OMEGA, 200, damping_ratio)
    else:
        assert energies(integrator, omega_dt / OMEGA, 200, damping_ratio).max() <= 1 + 1e-9


def test_explicit_refuses_steps_beyond_its_stability_limit():
    # 2 sqrt(2) / omega for the undamped spring: -0.1 % runs, +0.1 % is refused with the limit in the message.
    limit = 2 * np.sqrt(2) / OMEGA
    assert energies("explicit", 0.999 * limit, 1000).max() <= 1 + 1e-9
    with pytest.raises(ValueError, match="dt"):
        energies("explicit", 1.01 * limit, 10)


def test_explicit_names_the_limit_of_the_starfish():  # ST-2
    # The catalogue's limit of 2.6e-4 s is that of semi-implicit Euler; RK4's follows from its stability region.
    body = ws.starfish()
    rates = np.linalg.eigvals(linearised(body))
    limit = longest_rk4_step(rates)
    physics = ws.Physics(integrator="explicit", dt=1e-3)
    with pytest.raises(ValueError, match="dt") as refusal:
        ws.simulate(body, still(body), physics=physics, duration=1.0)
    named_limit, named_mode = (float(n) for n in re.findall(r"([0-9.e-]+) (?:s \(|rad)", str(refusal.value)))
    assert named_mode == pytest.approx(1.88e3, rel=0.01)
    assert named_limit == pytest.approx(limit, rel=0.01)  # both 4.13e-4
