"""The learning curves: the right numbers, and a picture that can be read."""

import numpy as np
import pytest
from study.toy import outcome, study, toy

from wobblesim.analysis.figures.learning import _stride, curves
from wobblesim.analysis.figures.registry import Choice, draw
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
    figure = draw("figure-2b", results_of(tmp_path, "trial.duration=45")).figure
    axes = figure.axes[0]
    assert axes.get_xlabel() == "epoch"
    assert axes.get_ylabel() == "best trial of the epoch\n(body lengths in 45 s)"
    assert texts(figure) == ["wobble ends", "fixed", "mass"]
    assert "mean of 4 runs" in axes.get_title(loc="left")
    assert "99 % confidence" in axes.get_title(loc="left")
    assert len(axes.collections) == 2


def test_one_run_has_no_band_and_does_not_claim_one(tmp_path):
    axes = draw("figure-2b", results_of(tmp_path, seeds="1")).figure.axes[0]
    assert axes.get_title(loc="left") == "mean of 1 run a condition"


def test_wobbles_that_end_at_different_epochs_have_a_ring_each(tmp_path):
    results = results_of(tmp_path, "conditions.longer={wobble: {dimension: mass, amplitude: 0.2, period: 5, end: 9}}")
    figure = draw("figure-2b", results).figure
    rings = [line.get_xdata()[0] for line in figure.axes[0].get_lines() if line.get_marker() == "o"]
    assert rings == [6, 9]
    assert "wobble ends" not in texts(figure)


def test_many_conditions_have_a_legend_and_no_two_look_alike(tmp_path):
    thetas = ",".join(f"0.{k}" for k in range(61, 73))
    axes = draw("figure-2b", results_of(tmp_path, f"sweep.physics.theta={thetas}", seeds="0..1")).figure.axes[0]
    looks = [(line.get_color(), line.get_linestyle()) for line in axes.get_lines()[:14]]
    assert len(set(looks)) == 14
    assert len(axes.get_legend().get_texts()) == 14
    assert not axes.collections  # bands of fourteen would hide the curves


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


def test_the_table_has_each_point_and_its_band(tmp_path):
    results = results_of(tmp_path)
    drawing = draw("figure-2b", results)
    (fixed, mass), _ = curves(results)
    table = drawing.table.set_index("condition")
    for curve in (fixed, mass):
        mine = table.loc[curve.condition]
        assert mine["epoch"].tolist() == curve.epoch.tolist()
        assert mine["mean"].tolist() == curve.best.mean.tolist()
        assert mine["high"].tolist() == (curve.best.mean + curve.best.half_width).tolist()
        assert mine["n"].tolist() == curve.best.n.tolist() == [4] * 12
    assert set(table["epochs"]) == {1}
    lines = {line.get_label(): list(line.get_ydata()) for line in drawing.figure.axes[0].lines}
    assert lines["mass"] == table.loc["mass", "mean"].tolist()


def test_with_many_epochs_the_table_has_the_thick_and_the_thin_line(tmp_path):
    results = results_of(tmp_path, "learning.epochs=401", seeds="0..1")
    drawing = draw("figure-2b", results)
    for condition, mine in drawing.table.groupby("condition", sort=False):
        thick, thin = mine[mine["epochs"] == 5], mine[mine["epochs"] == 1]
        assert (len(thick), len(thin)) == (81, 401)
        assert thin["epoch"].tolist() == list(range(401))
        best = results.epochs("condition", "epoch", "best")
        means = best[best["condition"] == condition].groupby("epoch")["best"].mean()
        assert np.array_equal(thin["mean"], means)
        assert thick["mean"].iloc[0] == pytest.approx(means[:5].mean(), rel=1e-12)  # measured 2e-16
        drawn = [list(line.get_ydata()) for line in drawing.figure.axes[0].lines]
        assert thick["mean"].tolist() in drawn
        assert thin["mean"].tolist() in drawn


def test_a_band_of_two_runs_does_not_flatten_the_curves(tmp_path):
    drawing = draw("figure-2b", results_of(tmp_path, seeds="0..1"))
    low, high = drawing.figure.axes[0].get_ylim()
    means = drawing.table["mean"]
    assert drawing.table["low"].min() < low < means.min()
    assert drawing.table["high"].max() > high > means.max()
    assert high - low <= 2 * np.ptp(means) * (1 + 1e-12)


def test_conditions_that_are_not_asked_for_are_left_out(tmp_path):
    results = results_of(tmp_path)
    assert set(draw("figure-2b", results, Choice(conditions=("mass",))).table["condition"]) == {"mass"}


def test_an_epoch_in_which_every_trial_diverges_is_a_gap(tmp_path):
    def explode(body, behaviours, **_):
        return outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))

    sweep(study("log=epochs", seeds="0..1"), tmp_path, simulate=explode)
    drawing = draw("figure-2b", load(tmp_path))
    assert drawing.table["mean"].isna().all()
    assert set(drawing.table["n"]) == {0}
    assert texts(drawing.figure)[-2:] == ["fixed", "mass"]
