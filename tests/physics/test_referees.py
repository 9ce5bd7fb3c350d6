"""The referees themselves: closed forms against SciPy, twins against closed forms."""

import numpy as np
import pytest
from reference import explicit_twin, impulse_twin, midpoint_twin
from reference.law import contact_damping_ratio, rebound
from reference.scipy_reference import damped_oscillator, solve
from scenes import LENGTH, oscillators, random_behaviours, random_body
from scipy.integrate import solve_ivp

import wobblesim as ws

TWINS = {1: impulse_twin, 2: midpoint_twin, 4: explicit_twin}
GAIT = ws.Gait(period=0.5, max_amplitude=0.2)


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.5, 0.99, 1.0, 1.01, 3.0])
def test_rebound_formula_is_that_of_the_equation(ratio):
    def force(_, state):
        return state[0] + 2 * ratio * state[1]

    force.terminal, force.direction = True, -1
    path = solve_ivp(
        lambda t, s: (s[1], -force(t, s)), (0, 50), (0.0, 1.0), "DOP853", events=force, rtol=1e-11, atol=1e-13
    )
    assert rebound(ratio) == pytest.approx(abs(path.y_events[0][0, 1]), abs=1e-9)  # measured 4e-11


@pytest.mark.parametrize("restitution", [1e-3, 0.1, 0.5, 0.9, 1.0])
def test_damping_ratio_of_the_contact_inverts_the_rebound(restitution):
    assert rebound(contact_damping_ratio(restitution)) == pytest.approx(restitution, abs=1e-12)


@pytest.mark.parametrize("order", TWINS)
@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_twins_follow_the_damped_oscillator(order, ratio):
    body, errors = oscillators(10.0, [ratio]), []
    for dt in (2e-3, 1e-3):
        path = TWINS[order].simulate_one(
            body, np.zeros(0), gravity=(0, 0), floor=None, gait=GAIT, dt=dt, steps=round(0.5 / dt)
        )
        x = np.array(path.positions)[:, 1, 0] - LENGTH
        errors.append(np.abs(x - damped_oscillator(1.0, 10.0, ratio, dt * np.arange(len(x)))).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.06)


def test_two_methods_of_scipy_agree():
    body, behaviour = random_body(31), random_behaviours(1, 1, 2)[0]
    options = {"gravity": (3.0, -10.0), "gait": GAIT, "times": np.array([0.0, 0.2])}
    one = solve(body, behaviour, **options)
    two = solve(body, behaviour, method="Radau", tolerance=1e-10, **options)
    assert np.abs(one - two)[-1, 0].max() < 1e-7


def test_reference_refuses_a_frictional_floor():
    body = random_body(31)
    with pytest.raises(ValueError, match="friction"):
        solve(body, np.zeros(4), gravity=(0, -100), gait=GAIT, times=np.array([0, 1]), floor=ws.Floor())
