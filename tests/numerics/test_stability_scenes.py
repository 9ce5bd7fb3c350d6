"""Heavy chains, fast impacts and starts inside the floor, at the shipped step (ST-3, CF-7, CF-8)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import wobblesim as ws
from wobblesim.numerics import stability_scenes as scenes

SHIPPED = ws.Physics(precision="float64", refinements=0)


def test_the_chains_exact_motion_is_that_of_its_equations():
    chain, gravity = scenes.Chain(end_mass=7.0, nodes=4), 100.0
    k, m = chain.stiffness(gravity), chain.mass
    inverse = np.append(0.0, 1 / m)
    c = 2 * np.sqrt(k / (inverse[:-1] + inverse[1:]))

    def slope(_, state):
        y, v = np.append(0.0, state[:4]), np.append(0.0, state[4:])  # displacements from unstretched, downwards
        pull = k * np.diff(y) + c * np.diff(v)
        return np.concatenate([v[1:], gravity + (np.append(pull[1:], 0.0) - pull) / m])

    found = solve_ivp(slope, (0, 2), np.zeros(8), rtol=1e-10, atol=1e-12, method="Radau", t_eval=np.arange(11) * 0.2)
    np.testing.assert_allclose(chain.motion(gravity, 11, 0.2), found.y[3], atol=1e-7 * chain.static)
    assert chain.motion(gravity, 2, 1e3)[1] == pytest.approx(chain.static, rel=1e-9)


@pytest.mark.parametrize("end_mass", scenes.END_MASSES)
def test_a_heavy_end_stretches_the_chain_by_one_percent(end_mass):  # ST-3
    row = scenes.chain(end_mass, SHIPPED)
    assert row["status"] == "ok"
    assert row["final"] == pytest.approx(row["exact_final"], abs=0.003)  # measured 0.0005
    assert row["final"] == pytest.approx(1.0, abs=0.01)  # 0.006: what is left of the swing, in the exact motion too
    assert row["peak"] <= 2.1
    assert row["peak"] == pytest.approx(row["exact_peak"], abs=0.005)  # 0.0004
    assert row["path_error"] < 0.12  # 0.096 at dt 0.02, 0.024 at 0.01


@pytest.mark.parametrize("speed", scenes.SPEEDS)
def test_impacts_stay_above_the_documented_depth_and_come_back(speed):  # CF-7
    row = scenes.impact(speed, SHIPPED)
    assert row["status"] == "ok"
    assert 0 < row["deepest"] <= row["documented"]  # 0.46 of it
    assert row["through"] == 0
    assert 0.3 < row["least_rebound"] < row["largest_rebound"] < 1.0  # 0.455 to 0.850: docs/limits.md


@pytest.mark.parametrize("speed", scenes.SPEEDS)
def test_no_node_of_a_robot_goes_through_the_floor(speed):  # CF-7
    row = scenes.robot_impact(speed, SHIPPED)
    assert row["status"] == "ok"
    assert row["through"] == 0
    assert row["rise"] < 0.15  # 0.119 at 1e5 u/s and 0.002 below; 0 at dt 0.01


@pytest.mark.parametrize("depth", scenes.DEPTHS)
def test_a_start_inside_the_floor_ends_outside_with_the_laws_energy(depth):  # CF-8
    # half way up the robot at dt 0.02 it needs smaller steps: see below
    node, robot = scenes.start_inside(depth, SHIPPED if depth < 100 else replace(SHIPPED, dt=0.01))
    # sqrt(2 g depth) is not what a compliant floor promises: it holds kappa depth²/2
    assert node["energy_bound"] == pytest.approx(math.sqrt(ws.Floor().stiffness) * depth)
    for row in (node, robot):
        assert row["unbounded"] == "ok"
        assert row["through"] == 0
        assert 0 < row["exit"] <= row["energy_bound"]  # 0.72 of it
    if depth > 0.5:  # 0.1 u deep, gravity takes a part: 0.82
        assert node["exit"] == pytest.approx(node["law"], rel=0.15)  # 0.125 at dt 0.02, 0.031 at 0.01


def test_a_start_that_is_too_fast_for_the_bounds_says_so():
    physics = replace(SHIPPED, max_speed=1e4)
    node, robot = scenes.start_inside(400.0, physics)
    assert node["exit"] > physics.max_speed
    assert node["status"] == robot["status"] == "diverged"


def test_a_start_deep_inside_the_floor_is_refined():
    body = ws.starfish()
    deep = replace(body, position=body.position - np.array([0.0, 400.0]))
    trials = ws.simulate(deep, np.zeros((1, 24)), physics=ws.Physics(), duration=2.0)
    assert (trials.status[0], trials.dt[0]) == ("refined", 0.01)


def test_impulse_goes_no_deeper_than_one_step():
    row = scenes.impact(1e3, ws.Physics(integrator="impulse", refinements=0))
    assert row["status"] == "limited"
    assert 0 < row["deepest"] <= 2.0  # 1.94: moves are cut to 2 u
    assert row["through"] == 0
