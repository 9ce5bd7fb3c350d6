"""Stored tables come back as frames; means and differences are those of the textbook."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from study.toy import StopAfter, outcome, study, toy

from wobblesim.analysis import tables
from wobblesim.analysis.statistics import (
    _moments,
    baseline,
    describe,
    holm,
    mean_of,
    median_of,
    rank_biserial,
    summary,
)
from wobblesim.analysis.tables import load, remembered
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


@pytest.mark.parametrize("n", [8, 9, 20, 99, 100])
def test_the_interval_of_a_median_is_the_tightest_between_two_values_that_the_binomial_allows(n):
    values = np.random.default_rng(n).normal(size=n)
    # The median lies below the k-th value with the probability that at most k - 1 of n coins show heads.
    k = max(k for k in range(1, n) if stats.binom.cdf(k - 1, n, 0.5) <= 0.005)
    found = median_of(values)
    assert (found.low, found.high) == (np.sort(values)[k - 1], np.sort(values)[n - k])
    assert (found.median, found.n) == (np.median(values), n)


@pytest.mark.parametrize(("values", "median", "n"), [([], np.nan, 0), ([np.nan], np.nan, 0), ([1, 2, np.nan], 1.5, 2)])
def test_the_median_of_fewer_than_eight_has_no_interval(values, median, n):
    found = median_of(values)
    assert found.median == pytest.approx(median, nan_ok=True)
    assert found.n == n
    assert np.isnan([found.low, found.high]).all()
    assert np.isnan(median_of(np.arange(7.0)).low)


# --- effects -------------------------------------------------------------------------------------------------------


def test_the_effect_is_the_share_of_favourable_minus_unfavourable_ranks():
    # Kerby (2014), Comprehensive Psychology 3: favourable minus unfavourable evidence; ties have their mean rank.
    assert rank_biserial([1.0, 2.0, -3.0, 4.0]).effect == (1 + 2 + 4 - 3) / 10
    assert rank_biserial([1.0, 1.0, -1.0, 0.0, np.nan]).effect == pytest.approx((2 + 2 - 2) / 6)
    assert rank_biserial([1.0, 1.0, -1.0, 0.0, np.nan]).n == 3


def test_the_effect_of_effectsizes_example_is_theirs():
    before = np.array([1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30])
    after = np.array([0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29])
    found = rank_biserial(before - after, confidence=0.95)
    assert found.effect == pytest.approx(0.78, abs=0.005)
    # theirs is [0.30, 0.94], from the standard deviation at no effect
    assert (found.low, found.high) == pytest.approx((0.043, 0.946), abs=5e-4)
    assert their_interval(found.effect, 9, 0.95) == pytest.approx((0.2953631, 0.9441559), abs=5e-8)


def their_interval(effect, n, confidence):
    """The interval of effectsize 0.8 (R): normal in atanh, with the standard deviation at no effect."""
    deviation = np.sqrt((2 * n**3 + 3 * n**2 + n) / 6) / (n * (n + 1) / 2)
    half_width = stats.norm.ppf(0.5 + confidence / 2) * deviation
    return tuple(np.tanh(np.arctanh(effect) + np.array([-half_width, half_width])))


def test_where_there_is_little_effect_the_interval_is_effectsizes():
    differences = np.random.default_rng(4).normal(0.05, 1.0, 400)
    found = rank_biserial(differences)
    # measured 0.00018 and 0.00094
    assert (found.low, found.high) == pytest.approx(their_interval(found.effect, 400, 0.99), abs=0.002)


@pytest.mark.parametrize(("n", "shift"), [(2, 0.0), (5, 0.5), (20, -1.2)])
def test_mean_and_deviation_of_the_effect_are_those_of_normal_numbers(n, shift):
    values = np.random.default_rng(n).normal(shift, 1.0, (100_000, n))
    ranks = stats.rankdata(np.abs(values), axis=1)
    effects = (np.sign(values) * ranks).sum(axis=1) / ranks.sum(axis=1)
    mean, deviation = _moments(shift, n)
    assert abs(effects.mean() - mean) < 3 * deviation / np.sqrt(100_000)  # measured 0.57, 0.03 and 1.26 in place of 3
    assert effects.std() == pytest.approx(deviation, rel=0.01)  # measured 1.4e-3, 7e-4 and 3e-3
    assert _moments(0.0, n) == pytest.approx(
        (0.0, np.sqrt(n * (n + 1) * (2 * n + 1) / 24) * 4 / n / (n + 1)), rel=1e-12
    )


@pytest.mark.parametrize("n", [3, 10, 100])
def test_the_interval_leaves_out_no_effect_where_the_normal_approximation_of_wilcoxons_test_does(n):
    rng = np.random.default_rng(n)
    for shift in rng.uniform(-1.0, 1.0, 40):
        differences = rng.normal(shift, 1.0, n)
        found = rank_biserial(differences)
        p = stats.wilcoxon(differences, method="asymptotic").pvalue
        assert (found.low > 0.0 or found.high < 0.0) == (p < 0.01)
        assert -1.0 <= found.low <= found.effect <= found.high <= 1.0


@pytest.mark.parametrize("n", [1, 2, 8, 100, 10_000])
def test_effects_of_one_sign_reach_to_the_end_and_those_of_turned_differences_are_turned(n):
    found, turned = rank_biserial(np.arange(1.0, n + 1)), rank_biserial(-np.arange(1.0, n + 1))
    assert (found.effect, found.high) == (1.0, 1.0)
    assert -1.0 < found.low < 1.0
    assert (turned.effect, turned.low, turned.high) == (-1.0, -1.0, -found.low)


@pytest.mark.parametrize(
    ("n", "shift", "held"),
    # measured with these 20,000; effectsize's interval holds it in 0.964, 0.811 and 0.874 of them
    [(10, 0.0, 0.9937), (10, 1.0, 0.9774), (40, 1.0, 0.9852)],
)
def test_intervals_hold_the_effect_about_as_often_as_they_say_also_where_it_is_strong(n, shift, held):
    values = np.random.default_rng(7).normal(shift, 1.0, (20_000, n))
    ranks = stats.rankdata(np.abs(values), axis=1)
    sums = (ranks * (values > 0)).sum(axis=1).astype(int)
    true, _ = _moments(shift, n)
    of_sum = {total: rank_biserial(signed_ranks(total, n)) for total in np.unique(sums)}
    found = np.mean([of_sum[total].low <= true <= of_sum[total].high for total in sums])
    assert found == pytest.approx(held, abs=0.003)  # another sample: a standard deviation is 0.001


def signed_ranks(total, n):
    """Ranks 1 to n, those that are positive adding up to a total."""
    ranks = -np.arange(1.0, n + 1)
    for rank in range(n, 0, -1):
        if rank <= total:
            ranks[rank - 1], total = rank, total - rank
    return ranks


# --- families ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("p", "corrected"),
    [
        ([0.01, 0.02, 0.03, 0.04, 0.05], [0.05, 0.08, 0.09, 0.09, 0.09]),
        ([0.01, 0.04, 0.03, 0.005], [0.03, 0.06, 0.06, 0.02]),
        ([0.319, 0.201, 0.4, 0.374, 0.113], [0.957, 0.804, 0.957, 0.957, 0.565]),  # example of stdlib's padjust
        ([0.5, 0.6], [1.0, 1.0]),
        ([0.02, np.nan, 0.03], [0.04, np.nan, 0.04]),  # as R's p.adjust, which counts no NA
        ([np.nan], [np.nan]),
        ([], []),
    ],
)
def test_holms_correction_of_worked_examples(p, corrected):
    assert holm(p).tolist() == pytest.approx(corrected, rel=1e-12, nan_ok=True)


def test_holms_correction_is_bonferronis_closed_over_all_subfamilies():
    # Marcus, Peritz & Gabriel (1976): a hypothesis falls if all families that it is in fall; so its corrected p is the
    # largest of theirs, a family's being the least p times its size.
    p = np.random.default_rng(6).random(7) ** 3
    families = [np.array(it) for size in range(1, 8) for it in itertools.combinations(range(7), size)]
    largest = [max(min(1.0, len(it) * p[it].min()) for it in families if k in it) for k in range(7)]
    assert holm(p).tolist() == pytest.approx(largest, rel=1e-15)


# --- conditions ----------------------------------------------------------------------------------------------------


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


def test_a_description_has_both_intervals_and_counts_runs_in_which_a_trial_diverged(results):
    runs, rows = results.runs(), describe(results).set_index("condition")
    for condition, mine in runs.groupby("condition", observed=True):
        row = rows.loc[condition]
        low, high = stats.t.interval(0.99, 3, mine["performance"].mean(), stats.sem(mine["performance"]))
        assert row["mean"] - row["half_width"] == pytest.approx(low, rel=1e-12)
        assert row["mean"] + row["half_width"] == pytest.approx(high, rel=1e-12)
        assert row["diverged_runs"] == (mine["diverged"] > 0).sum() > 0
        assert np.isnan([row["median_low"], row["median_high"]]).all()  # four runs
    told = summary(results)
    pd.testing.assert_frame_equal(told[describe(results).columns], describe(results))


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


def test_remembered_runs_are_read_once_and_cannot_be_spoilt(results, monkeypatch):
    plain, kept = results.runs("condition", "seed", "performance"), remembered(results)
    pd.testing.assert_frame_equal(kept.runs("condition", "seed", "performance"), plain)
    monkeypatch.setattr(tables, "read_tables", None)
    spoilt = kept.runs()
    spoilt["performance"] = 0.0
    pd.testing.assert_frame_equal(kept.runs("condition", "seed", "performance"), plain)
