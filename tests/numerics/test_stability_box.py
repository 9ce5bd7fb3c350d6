"""How cells are classified, and what a few of them are."""

import math

import numpy as np
import pandas as pd
import pytest

import wobblesim as ws
from wobblesim.numerics import stability_box as box
from wobblesim.numerics import stability_safe as safe

TRYING = box.Trying(behaviours=4, seconds=2.0, compared=4, compared_seconds=2.0)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ((0, (0, 0), 0.0, 0, 0.0), "ok"),
        ((0, (0, 0), box.GAINS, 0, box.TOLERANCE), "ok"),
        ((0, (0, 0), 0.0, 0, 1.01 * box.TOLERANCE), "not converged"),
        ((0, (0, 2), 0.0, 0, math.inf), "not converged"),
        ((0, (0, 0), 0.0, 3, math.inf), "limited"),
        ((0, (0, 0), 1.01 * box.GAINS, 3, 0.0), "gains energy"),
        ((0, (0, 0), math.nan, 0, 0.0), "gains energy"),
        ((1, (1, 0), math.inf, 3, math.inf), "diverged"),
        ((1, (0, 0), 0.0, 0, 0.0), "diverged"),
        ((2, (2, 1), 0.0, 0, math.inf), "diverged"),
        ((2, (2, 2), math.inf, 3, math.inf), "too fast"),
        ((2, (0, 1), 0.0, 0, math.inf), "too fast"),
    ],
)
def test_the_first_rule_that_holds_decides(found, expected):
    assert box.classify(*found) == expected


def cell(**options):
    morphology = options.pop("morphology", ws.Morphology())
    (row,) = box.cells(ws.starfish(), morphology, ws.Physics(**options), [options["dt"]], TRYING)
    return row


def test_the_adult_is_ok_at_the_shipped_step():
    row = cell(dt=ws.Physics().dt)
    assert row["class"] == "ok"
    assert row["median_difference"] < 0.01  # 0.0006
    assert row["within"] == 1.0


def test_a_method_that_rings_is_found_out():
    # theta 1/2, a fifth of the mass and a coarse step: docs/design-changes.md
    row = cell(dt=0.04, theta=0.5, morphology=ws.Morphology(mass=0.2))
    assert row["class"] in ("diverged", "gains energy")


def test_impulse_gains_energy_where_its_cut_hides_it():
    row = cell(integrator="impulse", dt=0.01, morphology=ws.Morphology(mass=0.05))
    assert row["class"] == "gains energy"
    assert row["diverged"] == 0  # it looks harmless
    assert row["gain"] > 1  # 11


def test_stiff_light_muscles_diverge_without_a_floor_and_less_at_smaller_steps_and_weaker_gaits():
    found = box.corner(box.Box((0.05,), (1000.0,), (1.0,), ()), TRYING).set_index(["dt", "amplitude"])
    dt, amplitude = ws.Physics().dt, ws.Gait().max_amplitude
    assert found.loc[(dt, amplitude), "flight"] == TRYING.behaviours
    assert found.loc[(dt / 8, amplitude), ["floor", "flight"]].sum() == 0
    assert found.loc[(dt, 0.2 * amplitude), ["floor", "flight"]].sum() == 0
    assert (found["shipped_bound"] >= found["floor"]).all()


def test_a_robot_faster_than_the_bound_is_told_from_one_that_diverges():
    # Light, large and stiff: the muscles' answer to the gait's first moment passes 1e4 u/s at any step.
    light, dt = ws.Morphology(mass=0.05, stiffness=100.0, size=3.0), ws.Physics().dt / 4
    assert cell(dt=dt, morphology=light, max_speed=1e4)["class"] == "too fast"
    row = cell(dt=dt, morphology=light, max_speed=1e6)
    assert row["diverged"] == row["diverged_at_quarter"] == 0


def test_pull_across_the_muscles():
    # k 3000, m 1, e 0.1, dt 0.01: 0.01 sqrt(600)
    assert box.pull_across(ws.Morphology(), 0.01, 0.1) == pytest.approx(0.01 * math.sqrt(600.0))
    assert box.pull_across(ws.Morphology(mass=0.25, stiffness=4.0), 0.01, 0.1) == pytest.approx(0.04 * math.sqrt(600.0))


def test_explicits_limit_falls_with_the_root_of_the_mass():
    # With the floor's frequency independent of mass, the springs' modes decide: omega goes with 1/sqrt(m).
    found = box.explicit_limits(box.Box((0.25, 1.0), (1.0,), (1.0,), ()))
    light, adult = found["limit"]
    assert adult == pytest.approx(4.13e-4, rel=2e-3)
    assert light == pytest.approx(adult / 2, rel=1e-3)


def test_shares_of_each_row_add_up():
    cells = pd.DataFrame(
        {"integrator": "midpoint", "precision": "float32", "dt": [0.01] * 4, "class": ["ok", "ok", "limited", "ok"]}
    )
    (row,) = box.shares(cells).to_dict("records")
    assert row["ok"] == 0.75
    assert sum(row[name] for name in box.CLASSES) == 1.0


# --- safe factors ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("good", "expected"),
    [
        ([1, 1, 1, 1, 1], (0.1, 4.0)),
        ([1, 0, 1, 1, 1], (1.0, 4.0)),
        ([1, 1, 1, 0, 1], (0.1, 1.0)),
        ([0, 1, 1, 1, 0], (0.5, 2.0)),
        ([1, 1, 0, 1, 1], None),
    ],
)
def test_a_range_is_the_run_of_good_factors_around_the_adult(good, expected):
    assert safe.around_the_adult([0.1, 0.5, 1.0, 2.0, 4.0], [bool(value) for value in good]) == expected


def test_stable_is_not_converged():
    cells = pd.DataFrame(
        {
            "integrator": "midpoint", "dt": 0.01, "dimension": "mass", "factor": [0.5, 0.8, 1.0, 1.5, 2.0],
            "diverged": [1, 0, 0, 0, 0], "gain": [0, 0, 0, 0, 1.0],
            "median_difference": [0, 0.1, 0.0, 0.0, 0.0],
        }
    )  # fmt: skip
    (row,) = safe.ranges(cells).to_dict("records")
    assert (row["stable_low"], row["stable_high"]) == (0.8, 1.5)
    assert row["stable_amplitude"] == pytest.approx(0.2)
    assert (row["converged_low"], row["converged_high"]) == (1.0, 1.5)
    assert row["converged_amplitude"] == 0.0


@pytest.mark.nightly
def test_the_prototypes_lesson():
    # One stiffness for all nodes and theta 1/2: many of the light robot's trials diverge; per mass and theta 0.6, none.
    found = safe.theta_counts(safe.Thetas((0.5, 0.6), (0.02,), (0.5,), 256, 60.0)).set_index(["floor", "theta"])
    assert found.loc[("one for all", 0.5), "diverged"] > 50  # 89 to 96
    assert found.loc[("per mass", 0.6), "diverged"] == 0
    assert np.all(found["still_diverged"] <= found["diverged"])
