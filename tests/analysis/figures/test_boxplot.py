"""Boxplots: the numbers of a box against a slow twin, the paper's whiskers and notches, and what is drawn of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.cbook import boxplot_stats
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle

from wobblesim.analysis.figures.boxplot import Place, _draw, box_of

KNOWN = [3.1, 1.0, 2.0, 2.2, 2.4, 2.6, 2.8, 3.0, -1.5, 7.0, 2.5]


def slow_quantile(values, share):
    """Type 7 of Hyndman & Fan (1996): on the line between the two values around place (n - 1) share."""
    values = sorted(values)
    place = (len(values) - 1) * share
    below = math.floor(place)
    above = min(below + 1, len(values) - 1)
    return values[below] + (place - below) * (values[above] - values[below])


def slow_median_interval(values, confidence=0.99):
    """The order statistics that a binomial count of values below the median exceeds with at most half of 1 %."""
    values, n = sorted(values), len(values)
    below = 0.0
    for k in range(n):
        below += math.comb(n, k) / 2**n
        if below > (1 - confidence) / 2:
            return (values[k - 1], values[n - k]) if k else None
    return None


def drawn(values, width=0.6):
    axes = Figure().add_subplot()
    _draw(axes, Place("a", 3.0, width, "0.8"), box_of(values))
    return axes


def test_a_box_has_the_quartiles_whiskers_and_outliers_worked_out_by_hand():
    box = box_of(KNOWN)
    # In order: -1.5 1.0 2.0 2.2 2.4 2.5 2.6 2.8 3.0 3.1 7.0; places 2.5, 5 and 7.5 of 0 to 10.
    assert (box.q1, box.median, box.q3) == pytest.approx((2.1, 2.5, 2.9), rel=1e-15)
    assert (box.whisker_low, box.whisker_high) == pytest.approx((0.9, 4.1), rel=1e-15)  # 1.5 times 0.8 beyond the box
    assert box.outliers.tolist() == [-1.5, 7.0]
    assert box.n == 11


@given(st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=60))
def test_quartiles_and_whiskers_are_those_of_the_slow_twin_and_of_the_papers_words(values):
    box = box_of(values)
    low, middle, high = (slow_quantile(values, share) for share in (0.25, 0.5, 0.75))
    assert (box.q1, box.median, box.q3) == pytest.approx((low, middle, high), rel=1e-12, abs=1e-12)  # measured 2e-16
    # "the minimum and maximum value, or 1.5 x IQR, whichever is closer to the median"
    reach = 1.5 * (box.q3 - box.q1)
    assert box.whisker_low == min((min(values), box.q1 - reach), key=lambda end: abs(end - box.median))
    assert box.whisker_high == min((max(values), box.q3 + reach), key=lambda end: abs(end - box.median))
    beyond = [value for value in sorted(values) if not box.whisker_low <= value <= box.whisker_high]
    assert box.outliers.tolist() == beyond


@pytest.mark.parametrize("n", [1, 2, 5, 40, 101])
def test_quartiles_and_outliers_are_matplotlibs(n):
    values = np.random.default_rng(n).standard_cauchy(n)
    (theirs,) = boxplot_stats(values)
    box = box_of(values)
    assert (box.q1, box.median, box.q3) == (theirs["q1"], theirs["med"], theirs["q3"])
    assert box.outliers.tolist() == sorted(theirs["fliers"])


def test_the_notch_of_100_runs_goes_from_the_37th_to_the_64th_value():
    # A binomial count of 100 at 1/2 is 36 or less with probability 0.0033 and 37 or less with 0.0060, around 0.005.
    box = box_of(np.arange(1.0, 101.0))
    assert (box.median_low, box.median_high) == (37.0, 64.0)


@pytest.mark.parametrize("n", [7, 8, 9, 10, 25, 40, 100])
def test_the_interval_of_the_median_is_that_of_the_slow_twin(n):
    values = np.random.default_rng(n).normal(size=n)
    box, twin = box_of(values), slow_median_interval(values)
    if twin is None:
        assert np.isnan([box.median_low, box.median_high]).all()
    else:
        assert (box.median_low, box.median_high) == twin


def test_a_nan_is_left_out_and_nothing_but_nans_is_an_empty_box():
    assert box_of([np.nan, *KNOWN]).median == 2.5
    empty = box_of([np.nan, np.nan])
    assert empty.n == 0
    assert np.isnan([empty.q1, empty.median, empty.q3, empty.whisker_low, empty.median_high]).all()
    assert not [*drawn([np.nan]).lines, *drawn([np.nan]).patches]


def test_what_is_drawn_is_the_box():
    values = np.random.default_rng(4).standard_t(2, size=60)
    box, axes = box_of(values), drawn(values)
    (outline,) = (patch for patch in axes.patches if isinstance(patch, PathPatch))
    heights = outline.get_path().vertices[:, 1]
    edges = {box.q1, box.q3, box.median, box.median_low, box.median_high}
    assert set(heights) == edges
    ends = [sorted(line.get_ydata()) for line in axes.lines]
    assert sorted((box.whisker_low, box.q1)) in ends
    assert sorted((box.q3, box.whisker_high)) in ends
    assert [box.median, box.median] in ends
    (diamonds,) = (line for line in axes.lines if line.get_marker() == "d")
    assert diamonds.get_ydata().tolist() == box.outliers.tolist()
    assert len(box.outliers) >= 2


def test_the_waist_of_a_notched_box_is_half_as_wide_as_the_box():
    values = np.random.default_rng(1).normal(size=100)
    (outline,) = drawn(values, width=0.6).patches
    vertices = outline.get_path().vertices
    waist = vertices[vertices[:, 1] == box_of(values).median, 0]
    assert (waist.min(), waist.max()) == pytest.approx((3.0 - 0.15, 3.0 + 0.15))


def test_an_interval_taller_than_the_box_is_a_bar_and_no_notch_that_folds_over():
    values = np.arange(12.0)
    box, axes = box_of(values), drawn(values)
    assert box.median_low < box.q1
    bar = next(patch for patch in axes.patches if isinstance(patch, Rectangle))
    outline = next(patch for patch in axes.patches if isinstance(patch, PathPatch))
    assert (bar.get_y(), bar.get_y() + bar.get_height()) == (box.median_low, box.median_high)
    assert set(outline.get_path().vertices[:, 1]) == {box.q1, box.q3}


@pytest.mark.parametrize("values", [[2.5], [2.0, 3.0], [1.0] * 9])
def test_few_or_equal_values_are_drawn_without_a_notch_that_is_not_known(values):
    axes = drawn(values)
    assert any(line.get_ydata().tolist() == [np.median(values)] * 2 for line in axes.lines)
