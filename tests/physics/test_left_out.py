"""A term that a scene does not need is not compiled in, and the bits are those of the term present and inert.

The bits are compared on positions by value, so that -0 and +0 are equal: an inert term adds zeros, and -0 + 0 is +0.
Only a division would tell the two apart, and no step divides by a position or a velocity.
"""

import os
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from scenes import random_behaviours, triangle

import wobblesim as ws
from wobblesim.physics import simulate as module

ROOT = Path(__file__).parents[2]
STEPS = {"midpoint": 0.01, "impulse": 0.005, "explicit": 5e-4}
PRECISIONS = ["float32", "float64"]
TERMS = ["gravity", "friction", "restitution", "damping", "muscles", "floor", "recording", "all"]
N_STEPS, WIDTH, HEIGHT = 25, 16, 0.2


def raised(body, height):
    return replace(body, position=np.add(body.position, [0.0, height]))


# What a robot thrown at the floor does in 25 steps of the three integrators: it lands, bounces or slides.
THROWN = replace(raised(triangle(), HEIGHT), velocity=np.tile([30.0, -60.0], (3, 1)))
ACTIVE = random_behaviours(1, WIDTH, 2)
AT_REST = ACTIVE * [0, 0, 1, 1]


def without_friction(body):
    return replace(body, friction=np.zeros(3))


def without_damping(body):
    return replace(body, damping_ratio=np.zeros(3))


def elastic(integrator):
    """The floor whose restitution takes no code: 0 where contact is rigid, 1 where it is compliant."""
    return ws.Floor(restitution=0.0 if integrator == "impulse" else 1.0)


def inert(term, integrator):
    """Two calls, as settings of `simulate`, that differ in whether an inert term is compiled in."""
    scene, body, behaviours = ws.Scene(), THROWN, ACTIVE
    if term in ("gravity", "all"):
        scene = replace(scene, gravity=0.0)
    if term in ("restitution", "all"):
        scene = replace(scene, floor=elastic(integrator))
    if term in ("friction", "all"):
        body = without_friction(body)
    if term in ("damping", "all"):
        body = without_damping(body)
    if term in ("muscles", "all"):
        behaviours = AT_REST
    call = {"body": body, "behaviours": behaviours, "scene": scene, "record_every": 1}
    if term == "floor":  # it falls, from far too high to reach the floor
        call["body"] = raised(body, 1000.0)
        return call | {"scene": ws.Scene(floor=None)}, call
    if term == "recording":
        return call | {"record_every": None}, call
    return call, call | {"leave_out": False}


def run(integrator, precision, call):
    """The outcome, and which arguments of the compiled loop were None."""
    bounds = dict.fromkeys(("max_speed", "max_strain", "max_energy"))
    physics = ws.Physics(integrator=integrator, dt=STEPS[integrator], precision=precision, refinements=0, **bounds)
    with mock.patch.object(module, "advance", wraps=module.advance) as spy:
        trials = ws.simulate(**call, physics=physics, duration=N_STEPS * physics.dt, width=WIDTH, threads=1)
    _, constants, floor, friction, muscles, *_, frames, _, _ = spy.call_args.args
    named = {**constants._asdict(), "floor": floor, "friction": friction, "muscles": muscles, "frames": frames}
    return trials, {name for name, argument in named.items() if argument is None}


# The arguments that a term is compiled in with, by integrator where they differ.
DASHPOT = {"midpoint": "damping", "impulse": None, "explicit": "c"}
WEIGHT = {"midpoint": "weight", "impulse": "gravity", "explicit": "gravity"}
REBOUND = {"midpoint": "c_n", "impulse": "restitution", "explicit": "c_n"}


def left_out(term, integrator):
    """Names of the arguments that are None for the lack of a term, and are not where it is inert."""
    by_term = {
        "gravity": {WEIGHT[integrator]},
        "damping": {DASHPOT[integrator]} - {None},  # impulse: part of each spring's constants, no code of its own
        "restitution": {REBOUND[integrator]},
        "friction": {"friction"},
        "muscles": {"muscles"},
        "recording": {"frames"},
    }
    if term == "floor":
        of_floor = {"midpoint": {"c_n", "d_n", "d_t"}, "impulse": {"restitution"}, "explicit": {"c_n"}}
        return {"floor", "friction"} | of_floor[integrator]
    return by_term[term] if term in by_term else set().union(*by_term.values()) - {"frames"}


def check(term, integrator, precision):
    (trials, none), (twin, twin_none) = (run(integrator, precision, call) for call in inert(term, integrator))
    assert none - twin_none == left_out(term, integrator)
    assert twin_none <= none
    assert np.all(trials.displacement != 0)
    np.testing.assert_array_equal(trials.displacement, twin.displacement)
    np.testing.assert_array_equal(trials.status, twin.status)
    if term == "recording":
        return
    np.testing.assert_array_equal(trials.positions, twin.positions)
    spread = np.ptp(trials.positions[-1], axis=-1).max()  # u, over the lanes: muscles move every robot in its own way
    assert spread > 0.2 or term in ("muscles", "all")  # measured 0.46 or more
    lowest = trials.positions[..., 1, :].min()
    assert lowest > 900 if term == "floor" else lowest <= 0.0  # it touches the floor


@pytest.mark.parametrize("term", TERMS)
def test_same_bits_with_the_term_left_out_as_with_it_inert_by_default(term):
    check(term, ws.Physics().integrator, ws.Physics().precision)


@pytest.mark.nightly  # 48 kernels to compile
@pytest.mark.parametrize(("term", "integrator", "precision"), list(product(TERMS, STEPS, PRECISIONS)))
def test_same_bits_with_the_term_left_out_as_with_it_inert(term, integrator, precision):
    check(term, integrator, precision)


def check_all():
    for term, integrator, precision in product(TERMS, STEPS, PRECISIONS):
        check(term, integrator, precision)


def test_same_bits_of_every_integrator_in_either_precision_uncompiled():
    # The same kernels on rows of NumPy arrays, with the same operations in the same order: see `lanes.py`.
    code = "import sys; sys.path[:0] = ['.', 'tests', 'tests/physics']; import test_left_out as t; t.check_all()"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
