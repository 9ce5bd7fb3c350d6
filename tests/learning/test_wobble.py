"""The schedule of the morphology: paper sections II-C and III-A, `wobblesim/learning/wobble.py`."""

import cmath
import math
from fractions import Fraction

import numpy as np
import pytest

from wobblesim.learning.wobble import Wobble
from wobblesim.robot.morphology import Morphology

EPOCHS = np.arange(4000)
ADULT = Morphology()


def closed_form(n, amplitude, period, mean=1.0, end=2000, decay_start=1900, bound=math.inf):
    """The paper's factor at epoch n: the phase in exact fractions, the sine as part of a complex exponential."""
    if n >= end:
        return 1.0
    left = min(Fraction(1), Fraction(end - n, end - decay_start)) if end > decay_start else 1
    turns = (Fraction(n) / Fraction(period)) % 1
    return min(bound, mean + float(left) * amplitude * cmath.exp(2j * math.pi * float(turns)).imag)


SCHEDULES = {
    "the paper's": ({"amplitude": 0.5, "period": 25}, {}),
    "slow": ({"amplitude": 0.1, "period": 400}, {}),
    "a period that is no whole number": ({"amplitude": 0.3, "period": 12.5}, {}),
    "a long odd period": ({"amplitude": 0.9, "period": 77.7}, {}),
    "paused": ({"amplitude": 0.1, "period": 25, "upper_bound": 1.0}, {"bound": 1.0}),
    "shifted": ({"amplitude": 0.05, "period": 25, "mean": 0.95}, {}),
    "200 epochs": ({"amplitude": 0.5, "period": 25, "end": 200}, {"end": 200, "decay_start": 190}),
    "1000 epochs": ({"amplitude": 0.5, "period": 25, "end": 1000}, {"end": 1000, "decay_start": 950}),
    "all 4000 epochs": ({"amplitude": 0.5, "period": 25, "end": 4000}, {"end": 4000, "decay_start": 3800}),
    "a decay of its own": ({"amplitude": 0.5, "period": 25, "decay_start": 100}, {"decay_start": 100}),
    "no decay": ({"amplitude": 0.5, "period": 25, "decay_start": 2000}, {"decay_start": 2000}),
    "no amplitude": ({"amplitude": 0.0, "period": 25}, {}),
}


@pytest.mark.parametrize("name", SCHEDULES)
def test_factor_is_the_closed_form_at_all_4000_epochs(name):
    given, stated = SCHEDULES[name]
    wobble = Wobble("mass", **given)
    expected = [
        closed_form(n, given["amplitude"], given["period"], given.get("mean", 1.0), **stated) for n in range(4000)
    ]
    factors = wobble.factor(EPOCHS)
    assert factors == pytest.approx(np.array(expected), abs=1e-15, rel=0)  # measured 6.7e-16
    assert [wobble.factor(n) for n in range(4000)] == factors.tolist()
    assert factors.min() >= wobble.least_factor()


def test_rows_of_the_papers_schedule():
    wobble = Wobble("mass", amplitude=0.5, period=100)
    last = math.sin(2 * math.pi * 0.99)
    rows = {0: 1, 25: 1.5, 50: 1, 75: 0.5, 1875: 0.5, 1899: 1 + 0.5 * last, 1900: 1, 1925: 1.375, 1975: 0.875}
    assert {n: wobble.factor(n) for n in rows} == pytest.approx(rows, abs=1e-15)
    assert wobble.factor(1999) == pytest.approx(1 + 0.005 * last, abs=1e-15)
    assert [wobble.factor(n) for n in (2000, 2001, 3999, 10**9)] == [1.0] * 4


def test_peaks_at_a_quarter_of_a_period_of_25_epochs():
    # The peaks at 6.25, 18.75, ... fall between epochs; a period of 6.25 has its whole cycles at every 25th epoch.
    wobble = Wobble("mass", amplitude=0.5, period=25)
    assert wobble.factor(np.array([6.25, 18.75])).tolist() == [1.5, 0.5]
    near = 0.5 * math.cos(2 * math.pi * 0.25 / 25)
    assert [wobble.factor(6), wobble.factor(19)] == pytest.approx([1 + near, 1 - near], abs=1e-15)
    assert wobble.factor(np.arange(1900)).max() == pytest.approx(1 + near, abs=1e-15)
    assert Wobble("mass", amplitude=0.5, period=6.25).factor(np.arange(0, 1900, 25)).tolist() == [1.0] * 76


def test_amplitude_of_the_decay_is_linear():
    wobble = Wobble("mass", amplitude=0.4, period=4)  # odd epochs are the peaks and troughs
    size = np.abs(wobble.factor(np.arange(1899, 2000, 2)) - 1)
    assert size[0] == pytest.approx(0.4, abs=1e-15)
    assert size[1:] == pytest.approx(0.4 * (2000 - np.arange(1901, 2000, 2)) / 100, abs=1e-15)


def test_epochs_a_period_apart_have_the_same_bits():
    for period in (25, 7, 12.5):
        factors = Wobble("mass", amplitude=0.3, period=period).factor(np.arange(1900))
        step = round(2 * period)
        assert factors[step:].tobytes() == factors[:-step].tobytes()


def test_paused_form_rests_at_the_adult_for_half_of_each_period():
    factors = Wobble("mass", amplitude=0.1, period=20, upper_bound=1.0).factor(np.arange(1900)).reshape(95, 20)
    assert (factors[:, :11] == 1.0).all()
    assert (factors[:, 11:] < 1.0).all()
    assert factors.min() == pytest.approx(0.9, abs=1e-15)


def test_shifted_form_has_the_range_of_the_paused_one_and_jumps_to_the_adult():
    shifted = Wobble("mass", amplitude=0.05, period=20, mean=0.95)
    paused = Wobble("mass", amplitude=0.1, period=20, upper_bound=1.0)
    for wobble in (shifted, paused):
        factors = wobble.factor(np.arange(1900))
        assert (factors.min(), factors.max()) == pytest.approx((0.9, 1.0), abs=1e-15)
    assert shifted.factor(1990) == 0.95  # a zero of the sine: the mean stays to the end
    assert shifted.factor(2000) == 1.0


@pytest.mark.parametrize(("end", "decay_from"), [(2000, 1900), (200, 190), (20, 19), (19, 19), (1, 1), (4000, 3800)])
def test_the_last_5_percent_are_the_decay(end, decay_from):
    assert Wobble("mass", 0.1, 25, end=end).decay_from == decay_from


# --- dimensions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimension", ["mass", "stiffness", "size", "gravity"])
def test_one_dimension_wobbles_and_the_others_are_the_adults(dimension):
    wobble = Wobble(dimension, amplitude=0.5, period=100)
    assert wobble.morphology(25) == Morphology(**{dimension: 1.5})
    assert wobble.morphology(75) == Morphology(**{dimension: 0.5})
    assert wobble.morphology(0) == ADULT
    assert all(wobble.morphology(n) == ADULT for n in (2000, 3999))


def test_several_dimensions_wobble_together():
    wobble = Wobble(["mass", "size"], amplitude=0.5, period=100)
    assert wobble.morphology(25) == Morphology(mass=1.5, size=1.5)
    assert wobble == Wobble(("mass", "size"), amplitude=0.5, period=100)
    assert wobble.dimensions == ("mass", "size")


# --- refusals -------------------------------------------------------------------------------------------------------


def test_the_condition_as_printed_in_the_paper_is_refused_by_name():
    with pytest.raises(ValueError, match=r"^wobble: least mass factor is -0\.05, "):
        Wobble("mass", amplitude=0.95, period=25, mean=0.9)


@pytest.mark.parametrize(("amplitude", "least"), [(1.0, "0"), (1.5, "-0.5")])
def test_a_factor_of_zero_or_below_is_refused(amplitude, least):
    with pytest.raises(ValueError, match=f"^wobble: least mass and size factor is {least}, .*below the mean of 1$"):
        Wobble(("mass", "size"), amplitude=amplitude, period=25)


def test_least_factor():
    assert Wobble("mass", 0.95, 25).least_factor() == pytest.approx(0.05)
    assert Wobble("mass", 0.25, 25, mean=2.0).least_factor() == 1.0  # the adult's, from the end on
    assert Wobble("mass", 0.25, 25, upper_bound=0.5).least_factor() == 0.5


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"dimension": "weight"}, "dimension must be among mass, stiffness, size, gravity, got 'weight'"),
        ({"dimension": ("mass", "colour")}, "dimension"),
        ({"dimension": ()}, "dimension"),
        ({"amplitude": -0.1}, "amplitude"),
        ({"amplitude": math.nan}, "amplitude"),
        ({"amplitude": math.inf}, "amplitude"),
        ({"period": 0.0}, "period"),
        ({"period": 2}, "period"),
        ({"period": -25}, "period"),
        ({"period": math.inf}, "period"),
        ({"period": math.nan}, "period"),
        ({"end": 0}, "end"),
        ({"decay_start": -1}, "decay_start"),
        ({"decay_start": 2001}, "decay_start"),
        ({"mean": math.inf}, "mean"),
        ({"mean": math.nan}, "mean"),
        ({"upper_bound": 0.0}, "upper_bound"),
        ({"upper_bound": math.nan}, "upper_bound"),
    ],
)
def test_a_schedule_that_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(ValueError, match=f"^wobble: .*{message}"):
        Wobble(**{"dimension": "mass", "amplitude": 0.1, "period": 25, **wrong})
