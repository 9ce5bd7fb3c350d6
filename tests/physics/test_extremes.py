"""Degenerate geometry and crushed robots: a defined force or an input error, never a silent NaN."""

import numpy as np
import pytest
from measures import cross
from scenes import random_behaviours

import wobblesim as ws

DT = {"impulse": 0.005, "midpoint": 0.01, "explicit": 1e-4}


def simulate(body, integrator, duration, **options):
    physics = ws.Physics(integrator=integrator, dt=DT[integrator], precision="float64")
    record = round(duration / DT[integrator])
    return ws.simulate(
        body,
        random_behaviours(3, 2, body.n_groups),
        physics=physics,
        duration=duration,
        record_every=record,
        **options,
    )


COINCIDENT = ws.Body.from_arrays(
    [(0, 10), (0, 10), (10, 10)], [(0, 1), (1, 2)], stiffness=1000.0, rest_length=[5.0, 10.0], body_length=10.0
)
COLLINEAR = ws.Body.from_arrays([(0, 10), (10, 10), (20, 10)], [(0, 1), (1, 2), (0, 2)])


@pytest.mark.parametrize("body", [COINCIDENT, COLLINEAR], ids=["coincident", "collinear"])
@pytest.mark.parametrize("integrator", DT)
def test_degenerate_geometry_has_a_defined_force(integrator, body):  # ST-7
    trials = simulate(body, integrator, 1.0)
    assert np.isfinite(trials.positions).all()
    assert (trials.status == "ok").all()


def test_coincident_nodes_without_relative_motion_stay_together():  # ST-7
    pair = ws.Body.from_arrays([(0, 10), (0, 10)], [(0, 1)], rest_length=5.0)
    for integrator in DT:
        x = simulate(pair, integrator, 1.0).positions[-1, :, :, 0]
        np.testing.assert_array_equal(x[0], x[1])


@pytest.mark.parametrize("integrator", ["impulse", "midpoint"])
def test_sections_of_no_height_do_not_give_nan(integrator):  # ST-7
    trials = simulate(ws.starfish(arms=3, sections=2, height=1e-9), integrator, 1.0)
    assert (trials.status == "ok").all()
    assert np.isfinite(trials.positions).all()


def inverted_cells(body, x):
    """Cells (trials,) whose corners, counter-clockwise or clockwise as built, run the other way round."""

    def area(x):
        corner, following = x[body.cells], x[np.roll(body.cells, -1, axis=1)]
        return np.sum(cross(np.moveaxis(corner, 2, -1), np.moveaxis(following, 2, -1)), axis=1)

    return np.sum(area(x) * area(body.position[:, :, None]) < 0, axis=0)


@pytest.mark.parametrize("integrator", ["impulse", "midpoint"])
def test_crushed_robot_is_finite_and_counts_inverted_sections(integrator):  # EM-4
    body = ws.starfish()
    factors = ws.Morphology(mass=20.0, stiffness=0.01, size=0.2)
    trials = simulate(body, integrator, 5.0, morphology=factors)
    assert np.isfinite(trials.positions).all()
    np.testing.assert_array_equal(trials.inverted, inverted_cells(body, trials.positions[-1]))
    assert (trials.inverted > 0).all()
