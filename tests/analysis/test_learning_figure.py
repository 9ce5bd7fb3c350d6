"""The learning curves: the right numbers, and a picture that can be read."""

import numpy as np
import pytest
from study.toy import study, toy

from wobblesim.analysis.figures.learning import DASHES, OKABE_ITO, _spread, _stride, curves, learning_curves, save
from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import load
from wobblesim.study.execute import sweep


def results_of(folder, *settings, seeds=None):
    sweep(study("log=epochs", *settings, seeds=seeds), folder, simulate=toy)
    return load(folder)


def texts(figure):
    axes = figure.axes[0]
    return [text.get_text() for text in axes.texts]


def test_a_curve_is_the_mean_over_the_runs_of_the_best_trial_of_each_epoch(tmp_path):
    results = results_of(tmp_path)
    (fixed, mass), stride = curves(results)
    best = results.epochs()
    best = best[best["condition"] == "mass"]["best"].to_numpy().reshape(4, 12)
    assert (stride, mass.runs, mass.wobble_end) == (1, 4, 6)
    assert np.isnan(fixed.wobble_end)
    assert mass.epoch.tolist() == list(range(12))
    assert np.array_equal(mass.best.mean, mean_of(best).mean)
    assert np.array_equal(mass.best.half_width, mean_of(best).half_width)


def test_the_picture_names_its_axes_its_curves_and_the_end_of_the_wobble(tmp_path):
    figure = learning_curves(results_of(tmp_path, "trial.duration=45"))
    axes = figure.axes[0]
    assert axes.get_xlabel() == "epoch"
    assert axes.get_ylabel() == "best trial of the epoch\n(body lengths in 45 s)"
    assert texts(figure) == ["wobble ends", "fixed", "mass"]
    assert "mean of 4 runs" in axes.get_title(loc="left")
    assert "99 % confidence" in axes.get_title(loc="left")
    assert len(axes.collections) == 2


def test_one_run_has_no_band_and_does_not_claim_one(tmp_path):
    axes = learning_curves(results_of(tmp_path, seeds="1")).axes[0]
    assert axes.get_title(loc="left") == "mean of 1 run a condition"


def test_wobbles_that_end_at_different_epochs_have_a_ring_each(tmp_path):
    results = results_of(tmp_path, "conditions.longer={wobble: {dimension: mass, amplitude: 0.2, period: 5, end: 9}}")
    figure = learning_curves(results)
    rings = [line.get_xdata()[0] for line in figure.axes[0].get_lines() if line.get_marker() == "o"]
    assert rings == [6, 9]
    assert "wobble ends" not in texts(figure)


def test_many_conditions_have_a_legend_and_no_two_look_alike(tmp_path):
    thetas = ",".join(f"0.{k}" for k in range(61, 73))
    axes = learning_curves(results_of(tmp_path, f"sweep.physics.theta={thetas}", seeds="0")).axes[0]
    looks = [(line.get_color(), line.get_linestyle()) for line in axes.get_lines()[:14]]
    assert len(set(looks)) == 14
    assert len(axes.get_legend().get_texts()) == 14


def test_a_picture_is_a_png_of_a_size_for_a_page(tmp_path):
    path = tmp_path / "curve.png"
    save(learning_curves(results_of(tmp_path / "results")), path)
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(path.read_bytes()[16:20]) >= 800


def test_the_colours_differ_also_in_grey_or_by_their_dashes():
    assert len(set(OKABE_ITO)) == 8
    assert len(set(DASHES)) == 4


@pytest.mark.parametrize(
    ("epochs", "periods", "stride"),
    [
        (300, [25.0], 1),
        (4000, [], 10),
        (4000, [25.0], 25),
        (4000, [5.0], 10),
        (4000, [25.0, 50.0, 100.0], 100),
        (4000, [25.0, 400.0], 10),
    ],
)
def test_a_point_is_a_whole_number_of_periods_where_these_are_short(epochs, periods, stride):
    assert _stride(epochs, np.array(periods)) == stride


def test_labels_keep_their_order_and_a_distance_and_move_no_more_than_needed():
    moved = _spread([1.0, 1.0, 5.0, 1.1], 0.5)
    assert moved == pytest.approx([1 - 0.5 + 0.1 / 3, 1 + 0.1 / 3, 5.0, 1.5 + 0.1 / 3])
