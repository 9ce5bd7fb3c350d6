"""`wobblesim.starfish` against the starfish drawn by hand from the design (tests/reference/starfish_twin.py)."""

import numpy as np
import pytest
from reference.starfish_twin import draw

import wobblesim as ws

SHAPES = [
    {},
    {"arms": 3, "sections": 1, "groups_per_arm": 1},
    {"arms": 5, "sections": 7, "groups_per_arm": 3},
    {"arms": 4, "sections": 3, "height": 20.0, "width": 25.0, "center_side": 40.0},
    {"arms": 7, "sections": 2, "stiffness": {"side": 500.0, "tip": 1e4}},
]


def assert_same(body, drawing):
    np.testing.assert_allclose(body.position, drawing.positions(), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(body.springs, drawing.springs)
    np.testing.assert_array_equal(body.stiffness, drawing.stiffness)
    np.testing.assert_allclose(body.rest_length, drawing.lengths(), rtol=1e-12)
    muscles = sorted(zip(body.muscle_spring, body.muscle_group, body.muscle_sign, strict=True))
    assert muscles == sorted(drawing.muscles)


@pytest.mark.parametrize("shape", SHAPES)
def test_starfish_is_built_as_described(shape):
    body, drawing = ws.starfish(**shape), draw(**shape)
    assert_same(body, drawing)
    assert body.n_groups == shape.get("arms", 6) * shape.get("groups_per_arm", 2)
    np.testing.assert_array_equal(body.center, np.arange(shape.get("arms", 6)))
    assert body.body_length == pytest.approx(np.ptp(drawing.positions()[:, 0]))
    assert not body.fixed.any()
    assert not body.velocity.any()
    assert body.position[:, 1].min() == 0


def test_default_starfish_has_the_sizes_of_the_paper():
    body = ws.starfish()
    assert (body.n_nodes, body.n_springs, body.n_groups) == (108, 270, 12)
    assert round(body.body_length) == 772
    assert (body.mass == 1).all()
    assert (body.friction == 0.5).all()
    assert (body.damping_ratio == 1).all()


def test_six_pairs_of_centre_springs_are_doubled():
    pairs = [tuple(sorted(pair)) for pair in ws.starfish().springs[:18]]
    assert len(set(pairs)) == 12
    assert sum(pairs.count(pair) == 2 for pair in set(pairs)) == 6


@pytest.mark.parametrize("size", [0.5, 1.7])
def test_size_scales_heights_before_building(size):
    grown = ws.starfish(center_side=40.0).adapted(ws.Morphology(size=size))
    assert_same(grown, draw(center_side=40.0, size=size))
    assert grown.body_length == ws.starfish(center_side=40.0).body_length


def test_left_muscles_shorten_while_right_ones_lengthen():
    body = ws.starfish()
    left, right = body.muscle_sign[0::2], body.muscle_sign[1::2]
    assert (left == -1).all()
    assert (right == 1).all()
