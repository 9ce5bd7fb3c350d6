"""Trusted bounds: what they measure, what leaves them, and what becomes of it with a smaller step."""

import numpy as np
import pytest
from measures import kinetic_energy, spring_energy
from scenes import grains, random_behaviours, random_body, still, triangle

import wobblesim as ws
from wobblesim.physics.bounds import bounds_of, energy_scale, measured, start_energy
from wobblesim.physics.contract import State, rows, system_of
from wobblesim.physics.kernels import kernel
from wobblesim.physics.lanes import lanes, store

CHECK = 32  # steps between two looks
UNBOUND = {"max_speed": None, "max_strain": None, "max_energy": None}
FREE = ws.Scene(gravity=0.0, floor=None)


def same(trials, others, lanes=slice(None), but=()):
    """Whether the outcomes of some trials are those of others, bit for bit."""
    for name in {"displacement", "status", "dt", "bound", "limited", "diverged_at", "inverted"} - set(but):
        np.testing.assert_array_equal(getattr(trials, name)[lanes], getattr(others, name), err_msg=name)
    return True


# --- what is measured ----------------------------------------------------------------------------------------------


@kernel
def measure(tag, bounds, state, rest, place, out):
    fastest, strain, energy, total = measured(tag, bounds, state, rest, place)
    store(tag, out, 0, fastest)
    store(tag, out, 1, strain)
    store(tag, out, 2, energy)
    store(tag, out, 3, total)


@pytest.mark.parametrize("integrator", ["midpoint", "impulse"])  # one keeps its positions ahead of time
def test_speed_strain_and_energy_are_those_of_the_textbook(integrator):
    body, scene = random_body(7), ws.Scene(gravity=(30.0, -90.0))
    physics, tag = ws.Physics(integrator=integrator), lanes(np.float64, 4)
    system = system_of(body, scene, 1.0)
    method = ws.INTEGRATORS[integrator].prepare(system, physics, tag.dtype)
    rng = np.random.default_rng(0)
    x, v = body.position[..., None] + rng.normal(0, 5, (8, 2, 4)), rng.normal(0, 20, (8, 2, 4))
    v[body.fixed] = 0.0
    state = State(*(rows(8, tag) for _ in range(4)))
    for target, source in zip(state, (*np.moveaxis(x + method.ahead * v, 1, 0), *np.moveaxis(v, 1, 0)), strict=True):
        target[:] = source[method.node_order]
    rest, out = rows(len(system.rest), tag), rows(4, tag)
    rest[:] = system.rest[:, None]
    constants = bounds_of(system, method, physics, body.body_length, 0.1, tag.dtype)
    measure(tag, constants, state, rest, rows(16, tag), out)

    x, v = np.moveaxis(x, 2, 0), np.moveaxis(v, 2, 0)
    np.testing.assert_allclose(np.sqrt(out[0]), np.linalg.norm(v, axis=-1).max(axis=1), rtol=1e-14)
    a, b = body.springs.T
    length = np.linalg.norm(x[:, b] - x[:, a], axis=-1)
    assert body.rest_length.min() > 0.1 * body.rest_length.mean()
    np.testing.assert_allclose(out[1], np.abs(length / body.rest_length - 1).max(axis=1), rtol=1e-12)
    weight = np.where(body.fixed, 0.0, body.mass) @ (x @ np.array([30.0, -90.0])).T
    expected = 0.99 * kinetic_energy(body, v) + spring_energy(body, x) - weight
    np.testing.assert_allclose(out[2], expected, rtol=1e-12)
    still_there = kinetic_energy(body, body.velocity) + spring_energy(body, body.position[None])[0]
    still_there -= np.where(body.fixed, 0.0, body.mass) @ body.position @ [30.0, -90.0]
    assert start_energy(system) == pytest.approx(still_there, rel=1e-13)


@pytest.mark.parametrize(("length", "time", "mass"), [(1000.0, 1.0, 1.0), (1.0, 0.01, 1.0), (0.01, 60.0, 1e-6)])
def test_a_robot_in_other_units_has_the_same_bounds(length, time, mass):
    body = random_body(3)
    other = ws.Body.from_arrays(
        body.position * length, body.springs, mass=body.mass * mass, velocity=body.velocity * length / time,
        stiffness=body.stiffness * mass / time**2, damping_ratio=body.damping_ratio, fixed=body.fixed,
        rest_length=body.rest_length * length,
        muscles=list(zip(body.muscle_spring, body.muscle_group, body.muscle_sign, strict=True)),
    )  # fmt: skip
    floor, its_floor = ws.Floor(), ws.Floor(stiffness=ws.Floor().stiffness / time**2)
    scale = energy_scale(system_of(body, ws.Scene(100.0, floor), 1.0), body.body_length, 0.1)
    there = system_of(other, ws.Scene(100.0 * length / time**2, its_floor), 1.0)
    assert energy_scale(there, other.body_length, 0.1) == pytest.approx(
        scale * mass * length**2 / time**2, rel=1e-12
    )  # fmt: skip


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("integrator", ["midpoint", "impulse", "explicit"])
def test_a_long_fall_gains_no_energy(integrator, precision):
    # 60 s: 6,000 u/s and 180,000 u down, 18,000 times the energy scale of a node of length 1 u.
    physics = ws.Physics(integrator=integrator, dt=0.01, precision=precision)
    body = grains(np.zeros((1, 2)))
    trials = ws.simulate(body, still(body), scene=ws.Scene(floor=None), physics=physics, duration=60.0)
    assert trials.bound[0] == ""


# --- each bound is left for its own reason -------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_node_faster_than_the_bound_is_found_at_the_first_look(precision):
    body = grains(np.array([[3e4, 3.9e4], [3e4, 4.1e4]]), height=1.0)
    physics = ws.Physics(precision=precision, refinements=0)
    slow = grains(np.array([[3e4, 3.9e4]]), height=1.0)  # 49,204 u/s: the bound is on the speed, not on a component
    assert ws.simulate(slow, still(slow), scene=FREE, physics=physics, duration=1.0).status[0] == "ok"
    trials = ws.simulate(body, still(body), scene=FREE, physics=physics, duration=1.0)  # 50,804 u/s
    assert (trials.status[0], trials.bound[0]) == ("diverged", "speed")
    assert trials.diverged_at[0] == CHECK * physics.dt


@pytest.mark.parametrize(("displaced", "bound"), [(20.9, "strain"), (19.1, "")])
def test_a_node_placed_far_from_where_its_spring_rests_is_beyond_the_strain(displaced, bound):
    # A soft spring (period 20 s) of 10 u, stretched by so many times its length.
    body = ws.Body.from_arrays([(0, 0), (10 * (1 + displaced), 0)], [(0, 1)], rest_length=10.0, stiffness=0.05)
    physics = ws.Physics(refinements=0)
    trials = ws.simulate(body, still(body), scene=FREE, physics=physics, duration=1.0)
    assert trials.bound[0] == bound
    if bound:
        assert trials.diverged_at[0] == CHECK * physics.dt


OMEGA, AMPLITUDE = 2 * np.pi, 0.1
RESONANT = ws.Body.from_arrays(
    [(0, 0), (10, 0)], [(0, 1)], fixed=[True, False], stiffness=OMEGA**2, damping_ratio=0.0, muscles=[(0, 0, 1.0)]
)  # fmt: skip


def crossing(dt: float) -> float:
    """When a look finds an undamped spring, driven at its own frequency, beyond the bound of the energy.

    From rest, with x the stretch over the mean length L and A the amplitude: x = (A L/2) (sin wt - wt cos wt).
    """
    t = dt * CHECK * np.arange(1, round(10 / dt) // CHECK)
    phase, drive = OMEGA * t, AMPLITUDE * 10
    x, v = drive / 2 * (np.sin(phase) - phase * np.cos(phase)), drive / 2 * OMEGA * phase * np.sin(phase)
    energy = 0.5 * OMEGA**2 * (x - drive * np.sin(phase)) ** 2 + 0.5 * v**2
    scale = 0.5 * OMEGA**2 * ((2 * drive) ** 2 + 0.01**2)
    return t[np.argmax(energy > ws.Physics().max_energy * scale)]


@pytest.mark.parametrize("integrator", ["midpoint", "impulse", "explicit"])
def test_a_resonance_without_damping_gains_more_energy_than_muscles_should_give(integrator):
    physics = ws.Physics(integrator=integrator, dt=0.002, precision="float64", refinements=0)
    trials = ws.simulate(RESONANT, [[1.0, 0.0]], scene=FREE, physics=physics, duration=10.0)
    assert trials.bound[0] == "energy"
    assert 2.5 < crossing(physics.dt) < 3.0  # periods of 1 s
    # measured: midpoint and explicit are found at the very look, 2.944 s; impulse, which damps, 2 looks later
    assert abs(trials.diverged_at[0] - crossing(physics.dt)) <= (2.1 if integrator == "impulse" else 1.1) * 0.064


def test_a_place_that_is_not_a_number_is_named_so():
    body = triangle()
    physics = ws.Physics(refinements=0)
    scene = ws.Scene(gravity=1e36, floor=None)
    trials = ws.simulate(body, still(body), scene=scene, physics=physics, duration=10.0)
    assert (trials.status[0], trials.bound[0]) == ("diverged", "number")


# --- bounds can be raised and taken away ---------------------------------------------------------------------------


@pytest.mark.parametrize("bound", ["max_speed", "max_strain", "max_energy"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_bound_is_above_0(bound, value):
    with pytest.raises(ValueError, match=f"{bound} is .*> 0, or None"):
        ws.Physics(**{bound: value})


@pytest.mark.parametrize("none", [None, np.inf])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_without_bounds_nothing_finite_diverges(none, precision):
    physics = ws.Physics(precision=precision, **dict.fromkeys(UNBOUND, none))
    fast = grains(np.array([[1e5, 1e5]]), height=1.0)
    soft = ws.Body.from_arrays([(0, 0), (1000, 0)], [(0, 1)], rest_length=10.0, stiffness=0.05)
    for body, behaviours in ((fast, still(fast)), (soft, still(soft)), (RESONANT, [[1.0, 0.0]])):
        trials = ws.simulate(body, behaviours, scene=FREE, physics=physics, duration=10.0)
        assert (trials.status[0], trials.bound[0]) == ("ok", "")


@pytest.mark.parametrize("integrator", ["midpoint", "impulse"])
def test_looking_changes_no_bits(integrator):
    body, behaviours = ws.starfish(), random_behaviours(5, 20, 12)
    options = {"integrator": integrator, "dt": 0.005}
    bounded, unbound = (
        ws.simulate(body, behaviours, physics=ws.Physics(**options, **bounds), duration=2.0) for bounds in ({}, UNBOUND)
    )
    assert same(bounded, unbound)


# --- a trial that leaves them is tried again with a smaller step ---------------------------------------------------

LIGHT, RINGING = ws.Morphology(mass=0.07), {"theta": 0.5, "dt": 0.02}


def ring(trials=slice(0, 32), record_every=None, duration=20.0, **physics):
    """Trials of a light robot with a weight of the new position that lets the stiffest springs ring."""
    behaviours = random_behaviours(1, 32, 12)[trials]
    physics = ws.Physics(**(RINGING | physics))
    return ws.simulate(
        ws.starfish(), behaviours, morphology=LIGHT, physics=physics, duration=duration, record_every=record_every
    )


@pytest.fixture(scope="module")
def ringing():
    """The same 32 trials, without and with refinement."""
    return ring(refinements=0), ring()


def test_what_blows_up_is_found_and_does_not_once_the_step_is_small_enough(ringing):
    coarse, refined = ringing
    left = coarse.status == "diverged"
    assert left.sum() >= 8  # measured 22 of 32
    assert set(coarse.bound[left]) <= {"energy", "speed", "strain"}
    assert np.isnan(coarse.displacement[left]).all()
    assert (refined.status[left] == "refined").all()
    np.testing.assert_array_equal(refined.bound, coarse.bound)
    assert np.isnan(refined.diverged_at).all()
    assert np.abs(refined.displacement).max() < 5.0  # measured 3.2 body lengths


def test_without_bounds_a_blow_up_may_end_in_a_finite_score_that_is_the_best_of_all(ringing):
    # The prototype's lesson: a score is whatever place is finite when the trial ends; here up to 127,000 body lengths.
    unbound, body = ring(refinements=0, record_every=1, **UNBOUND), ws.starfish()
    place = unbound.positions[:, body.center, 0].mean(axis=1, dtype=np.float64) / body.body_length
    far = (np.isfinite(place) & (np.abs(place) > 10)).any(axis=0)  # in 20 s; refined, none gets beyond 3.2
    assert far.sum() >= 8  # measured 22 of 32
    assert (ringing[0].status[far] == "diverged").all()


def test_a_refined_trial_has_the_bits_of_a_trial_with_that_step_and_others_have_theirs(ringing):
    _, refined = ringing
    left = refined.status == "refined"
    assert same(refined, ring(~left, refinements=0), ~left)
    for dt in np.unique(refined.dt[left]):  # measured: all at half the step
        chosen = left & (refined.dt == dt)
        assert 0 < dt < RINGING["dt"]
        assert same(refined, ring(chosen, refinements=0, dt=dt), chosen, but=("status", "bound"))
    one = int(np.flatnonzero(left)[0])
    assert same(refined, ring(slice(one, one + 1)), slice(one, one + 1))


def test_frames_of_a_refined_trial_are_taken_at_the_same_times():
    recorded, silent = ring(record_every=150), ring()
    assert same(recorded, silent)
    assert recorded.positions.shape == (7, 108, 2, 32)  # 1000 steps of 0.02 s: at 0, 3, .. 18 s
    left = recorded.status == "refined"
    assert (recorded.dt[left] == 0.01).all()
    fine = ring(left, refinements=0, dt=0.01, record_every=300)
    np.testing.assert_array_equal(recorded.positions[..., left], fine.positions)
    assert np.isfinite(recorded.positions).all()


def test_a_duration_of_no_whole_number_of_steps_is_the_same_time_after_refinement():
    # 16 s and a half step are rounded to 800 steps of 0.02 s; halved, that is 1600 and not 1601.
    odd, even = ring(duration=16.009), ring(duration=16.0)
    assert (odd.status == "refined").any()
    assert same(odd, even)


def test_a_hopeless_trial_has_diverged_after_three_more_tries():
    behaviours = np.array([[1.0, 0.0], [0.0, 0.0]])
    body = RESONANT
    hopeless, calm = 0, 1
    trials = ws.simulate(body, behaviours, scene=FREE, physics=ws.Physics(dt=0.01), duration=10.0, record_every=100)
    assert list(trials.status) == ["diverged", "ok"]
    assert list(trials.bound) == ["energy", ""]
    assert list(trials.dt) == [0.01 / 8, 0.01]
    assert np.isnan(trials.displacement[hopeless])
    assert trials.displacement[calm] == 0.0
    assert abs(trials.diverged_at[hopeless] - crossing(0.01 / 8)) <= 1.1 * CHECK * 0.01 / 8
    frames = np.isfinite(trials.positions[..., hopeless]).all(axis=(1, 2))
    assert frames.tolist() == [True] * 3 + [False] * 8  # those of 0, 1 and 2 s; found at 2.92 s


def test_a_bound_that_physics_passes_is_passed_with_every_step():
    # A fall comes to 60 u/s after 0.6 s; the look that sees it comes ever sooner after.
    physics = ws.Physics(dt=0.01, max_speed=60.0, precision="float64")
    body = grains(np.zeros((1, 2)), height=1000.0)
    trials = ws.simulate(body, still(body), scene=ws.Scene(floor=None), physics=physics, duration=2.0)
    assert (trials.status[0], trials.bound[0], trials.dt[0]) == ("diverged", "speed", 0.01 / 8)
    assert 0.6 < trials.diverged_at[0] <= 0.6 + (CHECK + 1) * 0.01 / 8


@pytest.mark.parametrize("refinements", [1, 2])
def test_no_more_is_tried_than_asked_for(refinements):
    physics = ws.Physics(refinements=refinements)
    trials = ws.simulate(RESONANT, [[1.0, 0.0]], scene=FREE, physics=physics, duration=10.0)
    assert (trials.status[0], trials.dt[0]) == ("diverged", physics.dt / 2**refinements)
