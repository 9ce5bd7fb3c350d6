"""Failure is data, per lane: what diverges, when that is seen, and that it touches no other lane."""

import numpy as np
import pytest
from scenes import chain, grains, random_behaviours, still, triangle

import wobblesim as ws

CHECK = 32  # steps between two looks for divergence
DT = {"impulse": 0.005, "midpoint": 0.01, "explicit": 1e-3}


def physics(integrator, **options):
    """One attempt only: what becomes of a trial with a smaller step is in `test_bounds.py`."""
    default = {"integrator": integrator, "dt": DT.get(integrator, 1e-3), "precision": "float64", "refinements": 0}
    return ws.Physics(**(default | options))


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
@pytest.mark.parametrize("bad", [0, 7, 19])
def test_one_diverging_lane_touches_no_other(integrator, bad):  # BI-11
    body, clean = triangle(), 0.05 * random_behaviours(1, 20, 2)
    spoilt = clean.copy()
    spoilt[bad, :2] = 40.0  # of an amplitude that should be at most 1
    options = {"physics": physics(integrator, max_speed=60.0), "duration": 2.0, "record_every": 1}
    good, batch = (ws.simulate(body, b, scene=ws.Scene(floor=None, gravity=0.0), **options) for b in (clean, spoilt))
    others = np.arange(20) != bad
    assert (good.status == "ok").all()
    assert batch.status[bad] == "diverged"
    assert np.isnan(batch.displacement[bad])
    assert 0 < batch.diverged_at[bad] <= 2.0
    found = round(batch.diverged_at[bad] / options["physics"].dt)
    assert np.isnan(batch.positions[found + 1 :, ..., bad]).all()
    assert np.isfinite(batch.positions[0, ..., bad]).all()
    np.testing.assert_array_equal(batch.positions[..., others], good.positions[..., others])
    np.testing.assert_array_equal(batch.displacement[others], good.displacement[others])
    np.testing.assert_array_equal(batch.status[others], good.status[others])
    assert np.isnan(batch.diverged_at[others]).all()


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_divergence_is_seen_within_32_steps(integrator):  # BI-10
    # A falling grain passes max_speed at a known step.
    options = physics(integrator, max_speed=60.0)
    body = grains(np.zeros((1, 2)), height=1000.0)
    trials = ws.simulate(body, still(body), scene=ws.Scene(floor=None), physics=options, duration=2.0)
    crossing = 60.0 / 100.0
    assert trials.status[0] == "diverged"
    assert crossing < trials.diverged_at[0] <= crossing + (CHECK + 1) * options.dt
    assert np.isnan(trials.displacement[0])


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_divergence_in_the_last_steps_is_seen(integrator):
    options = physics(integrator, max_speed=60.0)
    body = grains(np.zeros((1, 2)), height=1000.0)
    steps = round(0.6 / options.dt) + 2
    trials = ws.simulate(body, still(body), scene=ws.Scene(floor=None), physics=options, duration=steps * options.dt)
    assert trials.status[0] == "diverged"


@pytest.mark.parametrize("integrator", ws.INTEGRATORS)
def test_motion_below_the_bound_is_ok(integrator):
    options = physics(integrator, max_speed=60.0)
    body = grains(np.zeros((1, 2)), height=1000.0)
    trials = ws.simulate(body, still(body), scene=ws.Scene(floor=None), physics=options, duration=0.59)
    assert trials.status[0] == "ok"
    assert np.isnan(trials.diverged_at[0])
    assert trials.displacement[0] == 0


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_non_finite_motion_is_diverged(precision):
    # Gravity so large that distances overflow within the first 32 steps: infinity, then NaN.
    body = chain()
    options = physics("midpoint", precision=precision)
    trials = ws.simulate(body, still(body), scene=ws.Scene(gravity=1e30, floor=None), physics=options, duration=1.0)
    assert trials.status[0] == "diverged"
    assert np.isnan(trials.displacement[0])


def test_impulse_counts_each_cut_move_and_goes_on():
    # 450 u/s in steps of 0.005 s is a move of 2.25 u: cut to 2 u once, which leaves 400 u/s and cuts no more.
    body = grains(np.array([[450.0, 0.0], [10.0, 0.0]]), height=50.0, friction=0.0)
    trials = ws.simulate(
        body,
        still(body),
        scene=ws.Scene(gravity=0.0, floor=None),
        physics=physics("impulse"),
        duration=1.0,
        record_every=1,
    )
    assert trials.status[0] == "limited"
    assert trials.limited[0] == 1
    assert np.isnan(trials.diverged_at[0])
    moves = np.diff(trials.positions[:, 0, 0, 0])
    np.testing.assert_allclose(moves, 2.0, rtol=1e-12)


def test_cut_moves_are_counted_beyond_what_single_precision_counts():
    # 1000 grains in free fall at the top speed of impulse (2 u a step), cut at every step but the first: 2.0e7 cuts.
    body = ws.Body.from_arrays(np.zeros((1000, 2)), velocity=[0.0, -1000.0])
    scene = ws.Scene(gravity=100.0, floor=None)
    counts = {
        precision: ws.simulate(
            body, np.zeros((1, 0)), scene=scene, duration=100.0, physics=physics("impulse", precision=precision)
        ).limited[0]
        for precision in ("float32", "float64")
    }
    assert counts == {"float32": 20_000_000, "float64": 20_000_000}


@pytest.mark.parametrize("options", [{"threads": 0}, {"threads": -2}, {"width": -1}, {"record_every": 2.5}])
def test_counts_that_mean_nothing_are_refused(options):
    body = triangle()
    with pytest.raises(ValueError, match="must be a whole number from 1"):
        ws.simulate(body, random_behaviours(0, 2, body.n_groups), duration=0.1, **options)


def test_no_behaviours_are_refused():
    with pytest.raises(ValueError, match="at least one"):
        ws.simulate(triangle(), np.zeros((0, 2 * triangle().n_groups)), duration=0.1)


def test_what_a_diverged_lane_has_counted_does_not_depend_on_its_neighbours():
    # Fast motors from which moves are cut before and after the divergence is found; the neighbour lies still.
    body, behaviours = triangle(), random_behaviours(3, 2, 2)
    behaviours[0, :2] = 40.0
    behaviours[1, :2] = 0.0
    options = {"duration": 1.0, "physics": physics("impulse", max_speed=300.0)}
    alone = ws.simulate(body, behaviours[:1], **options)
    batch = ws.simulate(body, behaviours, **options)
    assert list(batch.status) == ["diverged", "ok"]
    assert alone.limited[0] == batch.limited[0] > 0
    assert alone.diverged_at[0] == batch.diverged_at[0]
