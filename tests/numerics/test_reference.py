"""The references of `wobblesim accuracy` against closed forms, other programs of the same equations, and each other."""

from dataclasses import replace

import numpy as np
import pytest
from reference import scipy_reference
from scenes import random_behaviours, random_body

import wobblesim as ws
from wobblesim.numerics import reference
from wobblesim.numerics.scenes import SCENES, Case

GAIT = ws.Gait(period=0.5, max_amplitude=0.2)


def network(**options):
    """A small random network in gravity, two trials."""
    body = random_body(41, **options)
    return Case(
        name="network", body=body, behaviours=random_behaviours(1, 2, body.n_groups),
        scene=ws.Scene((3.0, -10.0), None), gait=GAIT,
        morphology=ws.Morphology(mass=1.3, gravity=0.7), duration=0.4, frame=0.04,
    )  # fmt: skip


def test_scipy_solves_the_oscillator_as_its_closed_form_does():
    case = SCENES["oscillator"](False)[0]
    closed = reference.reference_of(case, "", lambda physics: None, 0.0).positions
    solved = reference.solve(reference.Equations.of(case), case.times)[:, 0]
    assert np.abs(solved - closed).max() < 5e-9  # u, measured 5.8e-10
    assert np.abs(closed[:, 1, 0] - 10.0).max() == pytest.approx(1.0)  # released 1 u from rest


def test_equations_agree_with_the_tests_own_spring_by_spring():
    case = network()
    adapted = case.body.adapted(case.morphology)
    ours = reference.solve(reference.Equations.of(case), case.times)
    for trial, behaviour in enumerate(case.behaviours):
        theirs = scipy_reference.solve(
            adapted, behaviour, gravity=0.7 * np.array([3.0, -10.0]), gait=GAIT, times=case.times
        )
        assert np.abs(ours[..., trial] - theirs).max() < 1e-7  # u and u/s, measured 2.1e-9


def test_force_is_the_slope_of_the_energy():
    equations = reference.Equations.of(network())
    equations = replace(equations, damping=0.0 * equations.damping)
    position, velocity = equations.start()
    acceleration = equations.acceleration(0.1, position, velocity)
    assert np.all(acceleration[equations.body.fixed] == 0.0)
    for node in np.flatnonzero(~equations.body.fixed):
        for axis in range(2):
            shifted = []
            for step in (-1e-5, 1e-5):
                moved = position.copy()
                moved[node, axis] += step
                shifted.append(sum(equations.energy(0.1, moved, 0.0 * velocity)))
            force = -(shifted[1] - shifted[0]) / 2e-5
            wanted = equations.body.mass[node] * acceleration[node, axis]
            assert force == pytest.approx(wanted, rel=1e-6, abs=1e-3)  # measured 1.8e-5 of up to 47,600


def test_energy_without_dampers_and_muscles_is_kept():
    case = network(muscles=0, fixed=1)
    body = replace(case.body, damping_ratio=0.0 * case.body.damping_ratio)
    case = replace(case, body=body, behaviours=np.zeros((1, 0)))
    equations = reference.Equations.of(case)
    states = reference.solve(equations, case.times)
    energy = np.array([sum(equations.energy(t, *state)) for t, state in zip(case.times, states, strict=True)])[:, 0]
    held = max(equations.energy(t, *state)[0][0] for t, state in zip(case.times, states, strict=True))
    assert np.ptp(energy) < 1e-7 * held  # measured 2.5e-10


def test_reference_of_scipy_bounds_its_own_error():
    case = SCENES["chain"](True)[0]
    found = reference.reference_of(case, "", lambda physics: None, 0.0)
    finer = reference.solve(reference.Equations.of(case), case.times, tolerance=1e-12)[:, 0]
    claimed = np.abs(found.coarser - found.positions).max()
    assert np.abs(found.positions - finer).max() < claimed < 1e-6  # u, measured 5.2e-11 and 3.8e-9


def test_reference_with_a_floor_knows_the_size_of_its_own_error_by_step_halving():
    case = SCENES["drop"](True)[0]

    def run(physics):
        return reference.by_steps(case, physics)

    rough, fine = (reference.reference_of(case, "compliant", run, dt) for dt in (4e-4, 5e-5))
    real, claimed = (np.median(reference_distance(*pair)) for pair in (
        (rough.positions, fine.positions), (rough.coarser, rough.positions)
    ))  # fmt: skip
    assert real < 2 * claimed  # measured 0.0018 u and 0.0021 u
    finer = np.median(reference_distance(fine.coarser, fine.positions))
    assert finer < 0.3 * claimed  # measured 0.12 times, at 1/8 of the step


def test_two_methods_of_one_contact_law_have_one_limit():
    case = SCENES["drop"](True)[0]
    midpoint, explicit = (
        reference.by_steps(case, ws.Physics(integrator=name, dt=5e-5, precision="float64", refinements=0)).positions
        for name in ("midpoint", "explicit")
    )
    assert np.median(reference_distance(midpoint, explicit)) < 1.5e-3  # u, measured 4.8e-4


def reference_distance(one, other):
    """Root mean square distance of the nodes at the end, (n_trials,) u."""
    return np.sqrt(((one[-1] - other[-1]) ** 2).sum(axis=1).mean(axis=0))


def test_frames_must_fall_on_whole_steps():
    case = SCENES["oscillator"](True)[0]
    with pytest.raises(ValueError, match=r"do not fall on whole steps"):
        reference.by_steps(case, ws.Physics(dt=0.03))
