"""The lookup of safe factors: inside, outside, which step would do, and the committed table itself."""

import json
import subprocess
import sys

import numpy as np
import pytest

import wobblesim as ws
from wobblesim.learning.run import Setup
from wobblesim.learning.search import Search
from wobblesim.learning.wobble import DIMENSIONS, Wobble
from wobblesim.numerics import safety
from wobblesim.numerics.stability_safe import is_stable

KNOWN = {
    "conditions": safety.table()["conditions"],
    "safe": {
        "midpoint": {
            "0.02": {"mass": [0.5, 2.0], "size": None},
            "0.01": {"mass": [0.2, 5.0], "size": [0.5, 2.0]},
            "0.005": {"mass": [0.1, 20.0], "size": [0.1, 2.0]},
        },
        "impulse": {"0.01": {"mass": None, "size": None}},
    },
}


def find(dt, factors, integrator="midpoint"):
    return safety.unsafe(integrator, dt, factors, KNOWN)


def test_inside_there_is_nothing_to_say():
    assert find(0.01, {"mass": (0.2, 5.0), "size": (0.9, 1.1)}) == []
    assert find(0.01, {"mass": (0.2 - 1e-12, 5.0)}) == []  # 1 - 0.8 is not quite 0.2
    assert find(0.01, {}) == []


def test_outside_names_the_largest_step_that_would_be_safe():
    (found,) = find(0.02, {"mass": (0.3, 1.7)})
    assert (found.dimension, found.safe, found.safe_dt) == ("mass", (0.5, 2.0), 0.01)
    assert str(found) == (
        "mass goes from 0.3 to 1.7, and midpoint at dt 0.02 is stable only from 0.5 to 2; dt 0.01 would be"
    )
    (found,) = find(0.02, {"mass": (0.15, 1.7)})
    assert found.safe_dt == 0.005


def test_each_side_counts():
    assert [f.safe_dt for f in find(0.02, {"mass": (0.9, 4.0)})] == [0.01]
    assert [f.safe_dt for f in find(0.01, {"mass": (0.9, 6.0)})] == [0.005]


def test_no_step_may_be_safe():
    (found,) = find(0.02, {"mass": (0.05, 1.5)})
    assert found.safe_dt is None
    assert "no step of the table would be" in str(found)


def test_a_dimension_without_any_safe_factor():
    (found,) = find(0.02, {"size": (0.9, 1.1)})
    assert (found.safe, found.safe_dt) == (None, 0.01)
    assert "stable at no factor" in str(found)


def test_a_step_between_two_is_judged_by_the_larger():
    assert find(0.011, {"mass": (0.3, 1.0)})[0].safe == (0.5, 2.0)
    assert find(0.0099, {"mass": (0.3, 1.0)}) == []
    assert find(0.001, {"mass": (0.1, 1.0)}) == []


def test_a_step_beyond_the_table_is_not_known_to_be_safe():
    (found,) = find(0.05, {"mass": (0.9, 1.1)})
    assert (found.safe, found.safe_dt) == (None, 0.02)


def test_a_step_that_is_unsafe_for_the_adult_is_found_without_a_wobble():
    (found,) = find(0.01, {}, "impulse")
    assert (found.dimension, found.safe_dt) == (safety.ADULT, None)
    assert str(found).startswith("impulse at dt 0.01 is not known to be stable for the adult robot")


def test_explicit_guards_itself():
    assert find(1.0, {"mass": (0.01, 100.0)}, "explicit") == []


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"amplitude": 0.5}, (0.5, 1.5)),
        ({"amplitude": 0.5, "upper_bound": 1.0}, (0.5, 1.0)),
        ({"amplitude": 0.05, "mean": 0.8}, (0.75, 1.0)),
        ({"amplitude": 0.05, "mean": 1.2}, (1.0, 1.25)),
    ],
)
def test_factors_of_a_wobble(options, expected):
    wobble = Wobble(dimension=("mass", "size"), period=25, **options)
    found = safety.factor_ranges(wobble)
    assert set(found) == {"mass", "size"}
    assert found["mass"] == found["size"] == pytest.approx(expected)
    factors = wobble.factor(np.arange(2100))
    assert expected[0] - 1e-12 <= factors.min() <= factors.max() <= expected[1] + 1e-12
    assert safety.factor_ranges(None) == {}


def setup(**options):
    defaults = {
        "body": ws.starfish(), "scene": ws.Scene(), "physics": ws.Physics(dt=0.02), "gait": ws.Gait(), "duration": 1.0,
        "search": Search(), "wobble": Wobble("mass", 0.7, 25), "epochs": 10,
    }  # fmt: skip
    return Setup(**(defaults | options))


def test_remarks_of_a_setup():
    (remark,) = safety.remarks(setup(), KNOWN)
    assert remark.endswith("dt 0.01 would be")
    assert safety.remarks(setup(wobble=None), KNOWN) == []


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"body": ws.starfish(arms=5)}, "robot"),
        ({"gait": ws.Gait(max_amplitude=0.2)}, "gait"),
        ({"scene": ws.Scene(gravity=50.0)}, "gravity"),
        ({"scene": ws.Scene(floor=None)}, "floor"),
        ({"scene": ws.Scene(floor=ws.Floor(restitution=0.1))}, "floor"),
        ({"physics": ws.Physics(dt=0.02, theta=0.9)}, "theta"),
        ({"physics": ws.Physics(dt=0.02, precision="float64")}, "precision"),
    ],
)
def test_a_remark_says_what_the_table_was_not_measured_with(options, name):
    assert safety.differences(setup(**options), KNOWN) == [name]
    (remark,) = safety.remarks(setup(**options), KNOWN)
    assert remark.endswith(f"(measured with another {name})")


# --- the committed table ---------------------------------------------------------------------------------------------


def test_the_committed_table_is_of_the_shipped_defaults():
    assert safety.differences(setup(physics=ws.Physics())) == []
    assert safety.differences(setup(physics=ws.Physics(integrator="impulse"))) == []


def test_the_committed_table_knows_the_shipped_step_and_every_dimension():
    ranges = safety.table()["safe"][ws.Physics().integrator][f"{ws.Physics().dt:g}"]
    assert set(ranges) == set(DIMENSIONS)
    # The paper wobbles by up to a half: that must be safe as shipped.
    assert safety.unsafe(ws.Physics().integrator, ws.Physics().dt, dict.fromkeys(DIMENSIONS, (0.5, 1.5))) == []


@pytest.mark.nightly
def test_the_committed_table_is_what_is_measured():
    from wobblesim.numerics.stability_box import Trying
    from wobblesim.numerics.stability_safe import factor_cells

    physics, known = ws.Physics(), safety.table()
    ends = known["safe"][physics.integrator][f"{physics.dt:g}"]
    trying = Trying(16, 10.0, 4, 2.0)
    for dimension, (low, high) in ends.items():
        cells = factor_cells([physics], [physics.dt], [low, 1.0, high], trying, [dimension])
        assert is_stable(cells).all(), dimension


def test_a_table_can_be_written_and_read(tmp_path):
    safety.write(KNOWN, tmp_path / "table.json")
    assert json.loads((tmp_path / "table.json").read_text()) == KNOWN


def test_the_lookup_needs_no_compiler():
    code = "import sys, wobblesim.numerics.safety as s; s.unsafe('midpoint', 0.01, {}); print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
