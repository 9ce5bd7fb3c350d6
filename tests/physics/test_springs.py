"""Statics and damping of springs against their formulas."""

import itertools

import numpy as np
import pytest
from reference.scipy_reference import damped_oscillator
from scenes import LENGTH, chain, hanging_masses, oscillators, still

import wobblesim as ws

STIFFNESSES, MASSES = (3e3, 1.2e4, 1e5, 5e5), (0.05, 1.0, 20.0)


def final(body, scene, integrator, dt, duration, morphology=None):
    physics = ws.Physics(integrator=integrator, dt=dt, precision="float64")
    trials = ws.simulate(
        body,
        still(body),
        morphology=morphology or ws.Morphology(),
        scene=scene,
        physics=physics,
        duration=duration,
        record_every=round(duration / dt),
    )
    return trials.positions[-1, :, :, 0]


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_hanging_mass_comes_to_rest_at_its_weight_over_the_stiffness(integrator):  # SD-8
    pairs = np.array(list(itertools.product(MASSES, STIFFNESSES)))
    body = hanging_masses(pairs[:, 0], pairs[:, 1])
    dt = 1e-4 if integrator == "explicit" else 0.005
    x = final(body, ws.Scene(floor=None), integrator, dt, 10.0)
    sag = -LENGTH - x[1::2, 1]
    expected = pairs[:, 0] * 100.0 / pairs[:, 1]
    np.testing.assert_allclose(sag / expected, 1.0, rtol=1e-3)  # measured 9.3e-10


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_damping_ratio_gives_the_decay(integrator):  # SD-9
    ratios, omega, duration = [0.0, 0.1, 0.5, 1.0, 2.0], 10.0, 2.0
    # The catalogue asks for omega dt <= 0.1; a method of order 1 adds omega dt / 2 to every damping ratio.
    dt = 0.002 / omega if ws.INTEGRATORS[integrator].order == 1 else 0.05 / omega
    body = oscillators(omega, ratios)
    physics = ws.Physics(integrator=integrator, dt=dt, precision="float64")
    trials = ws.simulate(
        body,
        still(body),
        scene=ws.Scene(gravity=0.0, floor=None),
        physics=physics,
        duration=duration,
        record_every=1,
    )
    stretch = trials.positions[:, 1::2, 0, 0] - LENGTH
    times = dt * np.arange(len(stretch))
    for i, ratio in enumerate(ratios):
        error = np.abs(stretch[:, i] - damped_oscillator(1.0, omega, ratio, times)).max()
        assert error < 0.02  # measured 0.019 (impulse), 4.9e-3 (midpoint), 9.3e-7 (explicit), all undamped


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_heavier_or_softer_chains_sag_more(integrator):  # EM-7
    def sag(**factors):
        x = final(chain(stiffness=5000.0), ws.Scene(floor=None), integrator, 0.0005, 2.0, ws.Morphology(**factors))
        return -x[-1, 1]

    heavier = [sag(mass=factor) for factor in np.geomspace(0.05, 20, 11)]
    stiffer = [sag(stiffness=factor) for factor in np.geomspace(0.2, 20, 11)]
    assert (np.diff(heavier) > 0).all()
    assert (np.diff(stiffer) < 0).all()


@pytest.mark.parametrize("end_mass", [1.0, 10.0, 100.0, 1000.0, 1e4])
def test_midpoint_holds_a_long_chain_with_a_heavy_end(end_mass):  # ST-3
    nodes, gravity = 40, 100.0
    carried = (np.arange(nodes)[::-1] + end_mass) * gravity  # by each spring, from the top
    stiffness = carried.sum() / (0.01 * LENGTH * nodes)  # 1 % of static stretch
    static = carried.sum() / stiffness
    # A spring's own damping ratio of 1 hardly brakes the whole chain: r of it makes the slowest mode about critical.
    slowest = np.sqrt(stiffness / nodes / (end_mass + nodes / 2.5))
    critical = 2 * stiffness / slowest / (2 * np.sqrt(stiffness * 0.5))
    for ratio in (1.0, critical):
        body = chain(nodes, end_mass, stiffness, ratio)
        physics = ws.Physics(integrator="midpoint", dt=0.01, precision="float64")
        trials = ws.simulate(
            body, still(body), scene=ws.Scene(floor=None), physics=physics, duration=20.0, record_every=1
        )
        stretch = -trials.positions[:, -1, 1, 0] - LENGTH * nodes
        assert stretch.max() <= 2.1 * static  # measured 1.996
    assert stretch[-1] == pytest.approx(static, rel=0.01)  # measured 3.2e-13
