"""Figure 4 B: the moving average against a slow twin, over full windows only, and the curve that is drawn of it."""

import numpy as np
import pytest
from study.toy import study, toy

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.exploration import moving_average, window_of
from wobblesim.analysis.figures.registry import Choice, draw
from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import load
from wobblesim.study.execute import sweep


def results_of(folder, *settings, seeds=None):
    sweep(study("log=epochs", *settings, seeds=seeds), folder, simulate=toy)
    return load(folder)


def slow_average(values, window):
    """The mean of the values around each, where they are all there."""
    averages = np.full(values.shape, np.nan)
    for place in range(window // 2, len(values) - window // 2):
        averages[place] = values[place - window // 2 : place + window // 2 + 1].mean(axis=0)
    return averages


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return results_of(tmp_path_factory.mktemp("toy"), "learning.epochs=40", "conditions.mass.wobble.end=20")


@pytest.fixture(scope="module")
def drawing(results):
    return draw("figure-4b", results)


# --- the average -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [1, 3, 101])
def test_the_average_is_that_of_the_slow_twin(window):
    values = np.random.default_rng(0).lognormal(-5.0, 3.0, (400, 3))
    expected = slow_average(values, window)
    assert moving_average(values, window) == pytest.approx(expected, rel=1e-12, nan_ok=True)  # measured 9e-16
    assert moving_average(values[:, 0], window) == pytest.approx(expected[:, 0], rel=1e-12, nan_ok=True)


def test_zeros_after_large_values_average_to_zero_and_not_to_their_rounding():
    values = np.concatenate([np.full(50, 1e9), np.random.default_rng(1).random(50), np.zeros(50)])
    assert (moving_average(values, 11)[105:145] == 0.0).all()


def test_an_average_is_only_where_the_whole_window_is():
    known = np.isfinite(moving_average(np.ones(300), 101))
    assert np.flatnonzero(known).tolist() == list(range(50, 250))
    assert np.isnan(moving_average(np.ones(100), 101)).all()
    holed = np.ones(9)
    holed[4] = np.nan
    assert np.flatnonzero(np.isfinite(moving_average(holed, 3))).tolist() == [1, 2, 6, 7]


@pytest.mark.parametrize(("epochs", "window"), [(4000, 101), (303, 101), (302, 99), (12, 3), (9, 3), (8, 1), (2, 1)])
def test_the_window_is_the_papers_and_odd_and_a_third_of_a_short_run(epochs, window):
    assert window_of(epochs) == window


# --- the figure ------------------------------------------------------------------------------------------------------


def test_a_curve_is_the_mean_over_runs_of_their_moving_averages(results, drawing):
    distances = results.epochs("condition", "seed", "epoch", "step_distance")
    for line, condition in zip(drawing.figure.axes[0].lines, ("fixed", "mass"), strict=False):
        mine = distances[(distances["condition"] == condition) & (distances["epoch"] > 0)]
        by_run = mine["step_distance"].to_numpy().reshape(4, 39).T
        mean, half_width, _ = mean_of(slow_average(by_run, 13)[6:-6].T)
        assert line.get_label() == condition
        assert line.get_xdata().tolist() == list(range(7, 34))
        assert line.get_ydata() == pytest.approx(mean, rel=1e-12)  # measured 9e-16
        table = drawing.table[drawing.table["condition"] == condition]
        assert table["epoch"].tolist() == line.get_xdata().tolist()
        assert table["mean"].tolist() == line.get_ydata().tolist()
        assert table["low"].to_numpy() == pytest.approx(mean - half_width, rel=1e-12)
        assert table["high"].to_numpy() == pytest.approx(mean + half_width, rel=1e-12)
        assert set(table["n"]) == {4}
        assert set(table["window"]) == {13}


def test_the_band_is_the_interval_of_the_table(drawing):
    for band, (_, table) in zip(
        drawing.figure.axes[0].collections, drawing.table.groupby("condition", sort=False), strict=True
    ):
        heights = band.get_paths()[0].vertices[:, 1]
        assert set(table["low"]) | set(table["high"]) <= set(heights)


def test_the_title_says_the_window_and_the_runs(drawing):
    title = drawing.figure.axes[0].get_title(loc="left")
    assert title == "moving average over 13 epochs, mean of 4 runs a condition, band: 99 % confidence"
    assert [text.get_text() for text in drawing.figure.axes[0].texts] == ["wobble ends", "fixed", "mass"]


def test_distances_that_span_decades_have_a_logarithmic_axis_and_others_begin_at_zero(results, monkeypatch):
    linear = draw("figure-4b", results).figure.axes[0]
    assert (linear.get_yscale(), linear.get_ylim()[0]) == ("linear", 0.0)
    monkeypatch.setattr("wobblesim.analysis.figures.search_distance.WIDE", 1.01)
    drawing = draw("figure-4b", results)
    low, high = drawing.figure.axes[0].get_ylim()
    assert drawing.figure.axes[0].get_yscale() == "log"
    assert (low, high) == pytest.approx((drawing.table["mean"].min() / 2, drawing.table["mean"].max() * 2))


def test_a_band_of_two_runs_does_not_flatten_the_curves(tmp_path):
    drawing = draw("figure-4b", results_of(tmp_path, seeds="0..1"))
    means = drawing.table["mean"]
    assert drawing.table["high"].max() > drawing.figure.axes[0].get_ylim()[1]
    assert drawing.figure.axes[0].get_ylim()[1] == pytest.approx(means.max() + np.ptp(means) / 2)


def test_one_run_has_no_band(tmp_path):
    drawing = draw("figure-4b", results_of(tmp_path, seeds="3"), Choice(conditions=("mass",)))
    assert "confidence" not in drawing.figure.axes[0].get_title(loc="left")
    assert drawing.table["low"].isna().all()
    assert set(drawing.table["condition"]) == {"mass"}


def test_a_run_of_one_epoch_is_refused(tmp_path):
    results = results_of(tmp_path, "learning.epochs=1", "conditions.mass.wobble.end=1", seeds="0")
    with pytest.raises(FigureError, match="runs need 2 epochs for it"):
        draw("figure-4b", results)
