"""Stored tables come back as frames; means and differences are those of the textbook."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from study.toy import StopAfter, outcome, study, toy

from wobblesim.analysis.statistics import baseline, mean_of, summary
from wobblesim.analysis.tables import load
from wobblesim.study.execute import sweep
from wobblesim.study.store import StoreError


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The toy study, its seeds added in two commands."""
    folder = tmp_path_factory.mktemp("toy")
    sweep(study(seeds="2..3"), folder, simulate=toy)
    sweep(study(), folder, simulate=toy)
    return load(folder)


def test_rows_come_by_condition_seed_and_epoch_whatever_was_computed_first(results):
    rows = results.epochs("condition", "seed", "epoch")
    expected = [(condition, seed, epoch) for condition in ("fixed", "mass") for seed in range(4) for epoch in range(12)]
    assert list(rows.itertuples(index=False, name=None)) == expected


def test_only_the_columns_asked_for_are_read(results):
    assert list(results.trials("slot", "performance").columns) == ["slot", "performance"]
    assert list(results.behaviours("genotype").columns) == ["genotype"]


def test_conditions_sort_in_the_order_of_the_study(results):
    assert results.runs("condition")["condition"].cat.categories.tolist() == ["fixed", "mass"]


def test_a_table_that_was_not_kept_is_refused_with_the_setting_that_keeps_it(tmp_path):
    sweep(study("log=epochs", seeds="0"), tmp_path, simulate=toy)
    with pytest.raises(StoreError, match="has no behaviours; set `log: behaviours`"):
        load(tmp_path).behaviours()


def test_a_folder_without_a_finished_run_is_refused(tmp_path):
    with pytest.raises(StoreError, match="holds no results"):
        load(tmp_path)
    sweep(study(), tmp_path, simulate=toy, stop=StopAfter(2))
    with pytest.raises(StoreError, match="no finished run yet"):
        load(tmp_path)


def test_the_interval_of_a_mean_is_students():
    values = np.random.default_rng(3).normal(2.0, 0.7, 9)
    found = mean_of(values)
    low, high = stats.t.interval(0.99, 8, loc=values.mean(), scale=stats.sem(values))
    assert found.mean == pytest.approx(values.mean(), rel=1e-14)
    assert found.mean - found.half_width == pytest.approx(low, rel=1e-12)
    assert found.mean + found.half_width == pytest.approx(high, rel=1e-12)


def test_99_of_100_intervals_hold_the_true_mean():
    values = np.random.default_rng(0).normal(5.0, 2.0, (6, 20_000))
    mean, half_width, _ = mean_of(values)
    # 20,000 intervals: the standard deviation of the share is 0.0007.
    assert np.mean(np.abs(mean - 5.0) <= half_width) == pytest.approx(0.99, abs=0.003)


@pytest.mark.parametrize(("values", "mean", "n"), [([], np.nan, 0), ([2.5], 2.5, 1), ([np.nan, 2.5], 2.5, 1)])
def test_fewer_than_two_values_have_no_interval(values, mean, n):
    found = mean_of(values)
    assert found.mean == pytest.approx(mean, nan_ok=True)
    assert np.isnan(found.half_width)
    assert found.n == n


def test_the_comparison_is_with_fixed_or_else_with_the_first():
    assert baseline(["mass", "fixed", "size"]) == "fixed"
    assert baseline(["mass", "size"]) == "mass"


def test_the_summary_pairs_runs_by_seed(results):
    runs = results.runs().pivot(index="seed", columns="condition", values="performance")
    fixed, mass = summary(results).to_dict("records")
    difference = (runs["mass"] - runs["fixed"]).to_numpy()
    test = stats.ttest_rel(runs["mass"], runs["fixed"]).confidence_interval(0.99)
    assert mass["difference"] == pytest.approx(difference.mean(), rel=1e-12)
    assert mass["difference"] - mass["difference_half_width"] == pytest.approx(test.low, rel=1e-9)
    assert mass["pairs"] == 4
    assert np.isnan(fixed["difference"])
    assert fixed["median"] == np.median(runs["fixed"])
    assert fixed["mean"] == pytest.approx(runs["fixed"].mean())


def test_the_summary_counts_the_trials_of_each_status(results):
    runs, rows = results.runs().groupby("condition", observed=True), summary(results).set_index("condition")
    for name in ("trials", "diverged", "refined", "limited"):
        assert rows[name].to_dict() == runs[name].sum().to_dict()
    assert (rows[["diverged", "refined"]] > 0).all(axis=None)


def test_a_failed_run_is_counted_and_left_out_of_mean_and_pairs(tmp_path):
    def fails_when_wobbled_low(body, behaviours, *, morphology, **settings):
        trials = toy(body, behaviours, morphology=morphology, **settings)
        if morphology.mass == 1.0:
            return trials
        return outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))

    config = study("conditions.mass.wobble.end=20", "learning.epochs=9")
    sweep(config, tmp_path, simulate=fails_when_wobbled_low)
    fixed, mass = summary(load(tmp_path)).to_dict("records")
    assert (fixed["excluded"], mass["excluded"], mass["runs"], mass["pairs"]) == (0, 4, 4, 0)
    assert np.isnan([mass["mean"], mass["median"], mass["difference"]]).all()
    assert mass["diverged"] > 4 * 8 * 20 * 0.8
    assert np.isfinite(mass["path_before"])


def test_frames_are_plain_numbers_and_words(results):
    frame = results.runs()
    assert frame["performance"].dtype == np.float64
    assert pd.api.types.is_integer_dtype(frame["diverged"])
