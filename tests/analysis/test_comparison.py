"""Tests and effects are those of the literature's worked examples; nothing that can be missing makes them fall over."""

import itertools
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from study.toy import StopAfter, study, toy

from wobblesim.analysis.comparison import PAIRS, compare, paired, ranges
from wobblesim.analysis.export import COLUMNS, as_data, as_latex, flat, p_text
from wobblesim.analysis.statistics import SUMMARIZED
from wobblesim.analysis.tables import Results, load
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import Manifest
from wobblesim.study.store import StoreError

# Hamilton depression scale of nine patients, before and after a tranquillizer (Hollander & Wolfe 1973, p. 29), the
# example of R's wilcox.test and of effectsize's rank_biserial.
BEFORE = np.array([1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30])
AFTER = np.array([0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29])

# Extra hours of sleep of ten patients with two drugs (Student 1908), R's `sleep`.
DRUG_1 = np.array([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
DRUG_2 = np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])

# Heights of cross- minus self-fertilized maize in eighths of an inch (Darwin 1876; Fisher 1935, The Design of
# Experiments, chapter 3).
MAIZE = np.array([49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48])

# Weights of eleven men in pounds, the example of Shapiro & Wilk (1965), section 4.
WEIGHTS = np.array([148, 154, 158, 160, 161, 162, 166, 170, 182, 195, 236])


# --- worked examples -----------------------------------------------------------------------------------------------


def test_the_signed_rank_test_is_that_of_hollander_and_wolfe():
    found = paired(BEFORE - AFTER)
    # R: V = 40 of 45, one-sided p-value = 0.01953
    assert (found["wilcoxon"], found["p"] / 2) == (45 - 40, pytest.approx(0.01953, abs=5e-6))
    assert found["effect"] == pytest.approx((40 - 5) / 45, rel=1e-15)  # effectsize: 0.78


def test_the_signed_rank_test_of_darwins_maize_is_an_enumeration_of_all_signs():
    ranks = stats.rankdata(np.abs(MAIZE))
    sums = np.array(list(itertools.product([0.0, 1.0], repeat=15))) @ ranks
    found = paired(MAIZE)
    assert found["wilcoxon"] == 24
    assert found["p"] == 2 * np.mean(sums <= 24)
    assert found["p"] == pytest.approx(0.0413, abs=5e-5)
    assert found["t"] == pytest.approx(2.148, abs=5e-4)  # Fisher: t = 2.148
    assert found["t_p"] == pytest.approx(0.0497, abs=5e-5)
    assert found["difference"] == pytest.approx(20.933, abs=5e-4)  # Fisher: 20.93 eighths


def test_the_paired_t_test_is_students():
    found = paired(DRUG_1 - DRUG_2)
    # R: t = -4.0621, df = 9, p-value = 0.002833, mean difference -1.58
    assert found["t"] == pytest.approx(-4.0621, abs=5e-5)
    assert found["t_p"] == pytest.approx(0.002833, abs=5e-7)
    assert found["difference"] == pytest.approx(-1.58, rel=1e-12)
    half_width = stats.t.ppf(0.995, 9) * 1.58 / 4.062128
    assert found["difference_half_width"] == pytest.approx(half_width, rel=1e-6)  # of the digits of t; measured 8e-8


def test_a_pair_without_a_difference_is_left_out_of_the_ranks_and_kept_in_the_mean():
    found = paired(DRUG_1 - DRUG_2)
    assert (found["n_pairs"], found["wilcoxon"], found["effect"]) == (10, 0.0, -1.0)
    assert found["p"] == 2 * 0.5**9  # exact, although there was a zero: all nine others have one sign


def test_the_test_of_normality_is_that_of_shapiro_and_wilk():
    found = paired(WEIGHTS)
    assert found["shapiro_w"] == pytest.approx(0.79, abs=0.005)  # theirs
    assert found["shapiro_p"] == pytest.approx(0.0067, abs=5e-5)  # R: W = 0.7888, p-value = 0.006704
    assert not found["normal"]
    assert np.isnan([found["t"], found["t_p"]]).all()
    assert paired(WEIGHTS, alpha=0.005)["normal"]


def test_many_pairs_have_the_normal_approximation_with_ties_corrected():
    differences = np.repeat(np.arange(1.0, 31.0), 2) * np.where(np.arange(60) % 3, 1.0, -1.0)
    n, ranks = 60, stats.rankdata(np.abs(differences))
    variance = n * (n + 1) * (2 * n + 1) / 24 - 30 * (2**3 - 2) / 48
    statistic = ranks[differences < 0].sum()
    p = 2 * stats.norm.cdf((statistic - n * (n + 1) / 4) / np.sqrt(variance))
    assert paired(differences)["p"] == pytest.approx(p, rel=1e-12)  # measured 0


# --- what has no answer --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("differences", [[], [np.nan, np.nan]])
def test_without_a_pair_there_is_no_number(differences):
    found = paired(differences)
    assert (found.pop("n_pairs"), found.pop("normal")) == (0, False)
    assert np.isnan(list(found.values())).all()


@pytest.mark.parametrize(
    "differences", [[0.3], [0.3, -0.1], [0.1, 0.1, 0.1, 0.1], [0.1, 0.1 + 1e-16, 0.1, 0.1 + 2e-16]]
)
def test_too_few_or_all_the_same_are_not_tested_for_normality(differences):
    found = paired(differences)
    assert np.isnan([found["shapiro_w"], found["shapiro_p"], found["t"], found["t_p"]]).all()
    assert found["p"] == {1: 1.0, 2: 1.0, 4: 0.125}[len(differences)]


def test_differences_that_are_all_zero_are_no_evidence_and_have_no_effect():
    found = paired(np.zeros(12))
    assert (found["n_pairs"], found["difference"], found["wilcoxon"], found["p"]) == (12, 0.0, 0.0, 1.0)
    assert np.isnan([found["effect"], found["effect_low"], found["effect_high"]]).all()


def test_the_normality_of_more_than_5000_differences_is_not_tested():
    assert np.isnan(paired(np.random.default_rng(0).normal(size=5001))["shapiro_p"])


# --- conditions of a study -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Given(Results):
    """Results with given scores."""

    scores: dict = field(default_factory=dict)

    def runs(self, *columns):
        rows = [(name, seed, score) for name, mine in self.scores.items() for seed, score in mine.items()]
        frame = pd.DataFrame(rows, columns=["condition", "seed", "performance"])
        frame["condition"] = pd.Categorical(frame["condition"], self.conditions, ordered=True)
        return frame.assign(**{name: 0 for name in SUMMARIZED if name not in frame})[list(columns)]


def given(tmp_path, seeds=(), **scores):
    """Results of scores by condition: a list for seeds from 0, or a dictionary."""
    scores = {name: mine if isinstance(mine, dict) else dict(enumerate(mine)) for name, mine in scores.items()}
    manifest = Manifest()
    manifest.conditions = {name: {"config": {}, "kernel": ""} for name in scores}
    manifest.runs = dict.fromkeys((name, seed) for name, mine in scores.items() for seed in mine)
    manifest.studies = [(list(scores), tuple(seeds))]
    return Given(tmp_path, manifest, scores)


RNG = np.random.default_rng(11)
FIXED = RNG.normal(5.0, 1.0, 30)
BETTER, ALIKE, WORSE = (FIXED + RNG.normal(shift, 0.5, 30) for shift in (1.0, 0.05, -0.4))


@pytest.fixture
def three(tmp_path):
    return given(tmp_path, range(30), better=BETTER, fixed=FIXED, alike=ALIKE, worse=WORSE)


def test_conditions_are_compared_with_fixed_seed_by_seed(three):
    found = compare(three)
    assert (found.baseline, found.alpha, found.notes) == ("fixed", 0.01, ())
    assert found.pairs["condition"].tolist() == ["better", "alike", "worse"]
    assert found.conditions["condition"].tolist() == ["better", "fixed", "alike", "worse"]
    for row, scores in zip(found.pairs.to_dict("records"), (BETTER, ALIKE, WORSE), strict=True):
        for name, value in paired(scores - FIXED).items():
            assert row[name] == pytest.approx(value, nan_ok=True, rel=1e-15)
    assert found.pairs["significant"].tolist() == [True, False, True]
    assert found.pairs["p_holm"].tolist() == (np.array([3, 1, 2]) * found.pairs["p"]).tolist()


def test_another_baseline_turns_the_signs(three):
    by_name = compare(three, baseline="worse").pairs.set_index("condition").loc["fixed"]
    usual = compare(three).pairs.set_index("condition").loc["worse"]
    assert by_name["difference"] == pytest.approx(-usual["difference"], rel=1e-15)
    assert (by_name["effect_low"], by_name["effect_high"]) == (-usual["effect_high"], -usual["effect_low"])
    assert by_name["p"] == usual["p"]


def test_the_family_is_what_is_compared(three):
    found = compare(three, conditions=["worse"])
    assert found.conditions["condition"].tolist() == ["fixed", "worse"]
    assert found.pairs["p_holm"].tolist() == found.pairs["p"].tolist()


def test_seeds_that_make_no_pair_are_named_with_the_reason(tmp_path):
    mass = {seed: 6.0 + seed for seed in range(12)} | {3: np.nan}
    fixed = {seed: 5.0 for seed in range(12) if seed not in (5, 6, 7, 9)} | {1: np.nan, 3: np.nan}
    found = compare(given(tmp_path, range(14), fixed=fixed, mass=mass))
    row = found.pairs.iloc[0]
    assert (row["n_pairs"], row["missing"]) == (6, 8)
    assert row["difference"] == np.mean([mass[seed] - 5.0 for seed in (0, 2, 4, 8, 10, 11)])
    assert found.conditions["excluded"].tolist() == [2, 1]
    assert found.notes[0] == (
        "mass: 8 of 14 seeds make no pair: 1 (no score in fixed), 3 (no score in fixed and no score in mass), "
        "5..7, 9 (no run of fixed), 12, 13 (no run of fixed and no run of mass)"
    )
    assert flat(found)["missing_seeds"].tolist() == ["", "1, 3, 5..7, 9, 12, 13"]
    assert as_data(found)["pairs"][0]["missing_seeds"][1] == {
        "seed": 3,
        "why": "no score in fixed and no score in mass",
    }


def test_what_no_difference_could_make_significant_is_said(tmp_path):
    few = compare(given(tmp_path, fixed=FIXED[:8], a=BETTER[:8], b=WORSE[:8]))
    assert few.notes == ("a, b: too few pairs for p below 0.01 after correction, whatever the differences",)
    enough = compare(given(tmp_path, fixed=FIXED[:8], a=BETTER[:8]))
    assert enough.notes == ()
    assert enough.pairs["p"].item() == 2 * 0.5**8  # the least that 8 pairs can have


def test_a_condition_without_a_pair_has_a_row_and_does_not_count_in_the_family(tmp_path):
    found = compare(given(tmp_path, fixed=FIXED, mass=BETTER, other={77: 1.0}, failed=np.full(30, np.nan)))
    rows = found.pairs.set_index("condition")
    assert rows["n_pairs"].to_dict() == {"mass": 30, "other": 0, "failed": 0}
    assert np.isnan(rows.loc[["other", "failed"], ["difference", "effect", "p", "p_holm"]]).all(axis=None)
    assert rows.loc["mass", "p_holm"] == rows.loc["mass", "p"]
    assert "other, failed: no pair, so that nothing is tested" in found.notes


def test_one_condition_has_nothing_to_compare(tmp_path):
    found = compare(given(tmp_path, mass=BETTER))
    assert (found.baseline, len(found.pairs), len(found.missing), found.notes) == ("mass", 0, 0, ())
    assert (
        found.pairs.dtypes.astype(str).to_dict()
        == compare(given(tmp_path, fixed=FIXED, mass=BETTER)).pairs.dtypes.astype(str).to_dict()
    )
    assert flat(found)["n_pairs"].isna().all()
    assert "tabular" in as_latex(found)


def test_a_sweep_in_work_is_compared_as_far_as_it_is(tmp_path):
    config = study("log=epochs", "conditions.size={wobble: {dimension: size, amplitude: 0.1, period: 5, end: 6}}")
    sweep(config, tmp_path, simulate=toy, stop=StopAfter(30))
    results = load(tmp_path)
    absent = [name for name in ("fixed", "mass", "size") if name not in results.conditions]
    found = compare(results)
    assert absent
    assert found.notes[0] == f"no finished run yet: {', '.join(absent)}"
    with pytest.raises(StoreError, match=f"has no finished run of {absent[-1]} yet"):
        compare(results, baseline=absent[-1])


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"baseline": "fxed"}, r"has no condition 'fxed'; did you mean fixed\?"),
        ({"conditions": ["wurse"]}, r"has no condition 'wurse'; did you mean worse\?"),
    ],
)
def test_an_unknown_condition_is_refused_with_the_nearest(three, settings, told):
    with pytest.raises(StoreError, match=told):
        compare(three, **settings)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, np.nan])
def test_a_threshold_is_a_probability(three, alpha):
    with pytest.raises(ValueError, match="alpha must be between 0 and 1"):
        compare(three, alpha=alpha)


# --- tables and words ----------------------------------------------------------------------------------------------


def test_the_flat_table_has_every_number_of_both_tables_under_a_name_with_a_meaning(three):
    found = compare(three)
    frame = flat(found)
    both = {*found.conditions, *PAIRS, "baseline", "alpha", "missing_seeds"}
    assert set(frame) == both == set(COLUMNS)
    assert frame["condition"].tolist() == ["better", "fixed", "alike", "worse"]
    others = frame[frame["condition"] != "fixed"].reset_index(drop=True)
    for name in PAIRS:
        assert others[name].tolist() == pytest.approx(found.pairs[name].tolist(), nan_ok=True)
    assert frame.loc[1, ["n_pairs", "p", "significant"]].isna().all()


def test_a_latex_table_escapes_the_ids_of_conditions(tmp_path):
    text = as_latex(compare(given(tmp_path, fixed=FIXED, **{"mass_0.5": BETTER, "50%&more": ALIKE})))
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert [row.partition(" & ")[0] for row in rows] == ["Condition", "fixed", r"mass\_0.5", r"50\%\&more"]
    assert all(row.replace(r"\&", "").count("&") == 9 for row in rows)
    assert text.count(r"\toprule") == text.count(r"\midrule") == text.count(r"\bottomrule") == 1
    assert rows[1].count("--") == 5
    assert r"$30$ & $+1." in rows[2]


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (1.0, "1.00"),
        (0.04999, "0.0500"),
        (0.000123456, "0.000123"),
        (9.9e-5, "< 0.0001"),
        (0.0, "< 0.0001"),
        (np.nan, "–"),
    ],
)
def test_a_p_value_has_three_digits(p, text):
    assert p_text(p) == text


@pytest.mark.parametrize(
    ("numbers", "text"), [([], ""), ([4], "4"), ([1, 2], "1, 2"), ([0, 1, 2, 5, 7, 8, 9], "0..2, 5, 7..9")]
)
def test_seeds_are_listed_as_ranges(numbers, text):
    assert ranges(numbers) == text
