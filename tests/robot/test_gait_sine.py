"""The gait's own sine: accurate, exact at quarter turns, and as good after many turns as in the first.

That its bits do not depend on the processor is shown in `tests/physics/test_golden.py`.
"""

import mpmath
import numpy as np
import pytest

from wobblesim.robot.gait import cos_turns, sin_turns

EXACT = {sin_turns: mpmath.sinpi, cos_turns: mpmath.cospi}
ULP = np.spacing(1.0)
rng = np.random.default_rng(0)
TURNS = {
    "one turn": np.concatenate([np.linspace(-1, 1, 4001), rng.uniform(-1, 1, 4000)]),
    "near quarter turns": np.arange(-8, 9)[:, None] / 4
    + np.outer(np.ones(17), [-1e-3, -1e-9, -1e-17, 1e-17, 1e-9, 1e-3]),
    "near eighths": np.arange(-8, 9)[:, None] / 8 + np.outer(np.ones(17), [-1e-9, -1e-16, 1e-16, 1e-9]),
    "a trial": np.arange(12_001) * 0.005 / 0.7,
    "a thousand turns": rng.uniform(-1e3, 1e3, 4000),
    "a million million turns": rng.uniform(-1e12, 1e12, 4000),
    "beyond the last fraction": np.array([2.0**51 + 0.5, 2.0**52, 2.0**53 + 2, 1e300, -1e17]),
    "tiny": np.array([5e-324, -1e-310, 1e-300, 1e-20, -1e-10]),
}


def errors(function, turns):
    """Distance from the true value of every angle, in units in the last place of 1."""
    with mpmath.workprec(200):
        return [
            float(abs(mpmath.mpf(float(value)) - EXACT[function](2 * mpmath.mpf(float(turn)))) / ULP)
            for value, turn in zip(function(turns).flat, np.asarray(turns).flat, strict=True)
        ]


@pytest.mark.parametrize("angles", TURNS)
@pytest.mark.parametrize("function", EXACT)
def test_within_two_units_in_the_last_place_of_1(function, angles):
    assert max(errors(function, TURNS[angles])) <= 2  # measured 0.71 (sine), 1.61 (cosine)


@pytest.mark.parametrize("whole", [0, 1, -3, 1000, 2**40, -(2**50)])
def test_exact_at_quarter_turns(whole):
    quarters = whole + np.array([0, 0.25, 0.5, 0.75])
    np.testing.assert_array_equal(sin_turns(quarters), [0, 1, 0, -1])
    np.testing.assert_array_equal(cos_turns(quarters), [1, 0, -1, 0])


@pytest.mark.parametrize("function", EXACT)
def test_whole_turns_change_no_bit(function):
    part = rng.integers(0, 2**20, 1000) / 2**20
    for whole in (1, -7, 2**30):
        np.testing.assert_array_equal(function(part + whole), function(part))


def test_sine_is_odd_and_cosine_even_to_the_bit():
    turns = TURNS["a thousand turns"]
    np.testing.assert_array_equal(sin_turns(-turns), -sin_turns(turns))
