"""Performance against exploration: the right dots and means, and Spearman's correlation as others compute it."""

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from study.toy import study, toy

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.exploring import correlation
from wobblesim.analysis.figures.registry import draw
from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import load
from wobblesim.study.execute import sweep

IQ = (106, 100, 86, 101, 99, 103, 97, 113, 112, 110)
HOURS = (7, 27, 2, 50, 28, 29, 20, 12, 6, 17)


@dataclass
class Made:
    """Results made by hand: the runs of a few conditions, as (search distance, performance)."""

    points: dict[str, list[tuple[float, float]]]

    @property
    def conditions(self):
        return list(self.points)

    def runs(self, *columns):
        rows = [
            {
                "condition": name,
                "seed": seed,
                "path_before": 0.25 * distance,
                "path_after": 0.75 * distance,
                "performance": performance,
                "trial.duration": 30.0,
            }
            for name, mine in self.points.items()
            for seed, (distance, performance) in enumerate(mine)
        ]
        frame = pd.DataFrame(rows)[list(columns)]
        if "condition" in frame:
            frame["condition"] = pd.Categorical(frame["condition"], self.conditions, ordered=True)
        return frame


def cloud(seed, shift=0.0):
    rng = np.random.default_rng(seed)
    return [(float(x), float(y)) for x, y in rng.uniform((1.0, 1.0 + shift), (2.0, 2.0 + shift), (12, 2))]


def lines_of(axes, size):
    return [line for line in axes.get_lines() if line.get_markersize() == size]


def test_the_correlation_is_that_of_a_worked_example():
    # https://en.wikipedia.org/wiki/Spearman's_rank_correlation_coefficient: rho = -29/165, p = 0.627188
    found = correlation(IQ, HOURS)
    assert found.spearman == pytest.approx(-29 / 165, rel=1e-14)
    assert found.p == pytest.approx(0.627188, abs=5e-7)
    assert found.n == 10


def test_ties_and_many_runs_are_as_scipy_has_them():
    rng = np.random.default_rng(4)
    distance, performance = rng.integers(0, 9, 60), rng.normal(size=60).round(1)
    expected = stats.spearmanr(distance, performance)
    assert correlation(distance, performance)[:2] == pytest.approx(tuple(expected), rel=1e-12)  # measured 0


@pytest.mark.parametrize("performance", [(1, 2, 3, 4), (4.0, 1.0, 3.0, 2.0, 5.0), (2, 1, 3, 6, 4, 5), (1, 1, 2, 3, 3)])
def test_the_p_of_few_runs_counts_all_orders(performance):
    n = len(performance)
    found = correlation(range(n), performance)
    orders = itertools.permutations(stats.rankdata(performance))
    correlations = np.array([np.corrcoef(range(n), order)[0, 1] for order in orders])
    above, below = (np.mean(sign * (correlations - found.spearman) >= -1e-12) for sign in (1, -1))
    assert found.p == pytest.approx(min(1.0, 2 * min(above, below)), rel=1e-12)


@pytest.mark.parametrize(
    ("distance", "performance"), [((1, 2), (3, 4)), ((1, 1, 1), (1, 2, 3)), ((1, 2, 3), (5, 5, 5))]
)
def test_nothing_to_rank_has_no_correlation(distance, performance):
    assert np.isnan(correlation(distance, performance)[:2]).all()


def test_correlations_are_over_all_runs_and_within_each_condition():
    made = Made({"fixed": cloud(1), "far": [(x + 3.0, y) for x, y in cloud(2, shift=4.0)]})
    table = draw("exploration", made).table
    every = np.array([*made.points["fixed"], *made.points["far"]])
    for key, points in {("all", ""): every, ("condition", "far"): np.array(made.points["far"])}.items():
        expected = stats.spearmanr(*points.T)
        found = table[(table["kind"] == key[0]) & (table["condition"] == key[1])].iloc[0]
        assert (found["spearman"], found["p"]) == pytest.approx((expected.statistic, expected.pvalue), rel=1e-12)
        assert found["n"] == len(points)


def test_dots_are_runs_and_large_marks_the_means_with_their_intervals():
    made = Made({"fixed": cloud(1), "far": cloud(2, shift=4.0)})
    drawing = draw("exploration", made)
    axes = drawing.figure.axes[0]
    for dots, mark, points in zip(lines_of(axes, 4), lines_of(axes, 9), made.points.values(), strict=True):
        assert dots.get_xydata() == pytest.approx(np.array(points), rel=1e-15)
        assert mark.get_xydata()[0] == pytest.approx(mean_of(points).mean, rel=1e-15)
    row = drawing.table[drawing.table["condition"] == "far"].iloc[-1]
    widths = mean_of(made.points["far"]).half_width
    assert row[["distance_half_width", "performance_half_width"]].tolist() == pytest.approx(list(widths), rel=1e-12)
    assert axes.get_ylabel() == "final performance\n(body lengths in 30 s)"


def test_the_distance_is_that_of_the_whole_ancestry(tmp_path):
    sweep(study("log=epochs", "learning.epochs=8", seeds="0..1"), tmp_path, simulate=toy)
    results = load(tmp_path)
    last = results.epochs("condition", "seed", "epoch", "path")
    last = last[last["epoch"] == 7]["path"]
    dots = draw("exploration", results).table.query("kind == 'run'")
    assert dots["distance"].tolist() == pytest.approx(last.tolist(), rel=1e-12)  # measured 2e-16


def test_runs_without_a_score_are_counted_and_not_drawn():
    points = cloud(1)
    made = Made({"fixed": [*points, (5.0, np.nan)], "lost": [(1.0, np.nan)]})
    drawing = draw("exploration", made)
    row = drawing.table[drawing.table["kind"] == "condition"].set_index("condition")
    assert row["excluded"].to_dict() == {"fixed": 1, "lost": 1}
    assert len(drawing.table[drawing.table["kind"] == "run"]) == 12
    assert row.loc["fixed", "spearman"] == pytest.approx(stats.spearmanr(*np.array(points).T).statistic, rel=1e-12)
    assert "2 runs without a score left out" in drawing.figure.get_suptitle()
    with pytest.raises(FigureError, match="no run that is shown has a score"):
        draw("exploration", Made({"lost": [(1.0, np.nan)]}))


def test_distances_that_differ_much_are_on_a_logarithmic_axis_and_those_of_zero_are_not():
    def scale(points):
        return draw("exploration", Made({"fixed": points})).figure.axes[0].get_xscale()

    assert scale([(1.0, 1.0), (2.9, 1.5)]) == "linear"
    assert scale([(1.0, 1.0), (3.1, 1.5)]) == "log"
    assert scale([(0.0, 1.0), (3.1, 1.5)]) == "linear"


def test_names_stand_beside_their_marks_or_in_a_legend_and_no_two_conditions_look_alike():
    apart = Made({f"c{k}": cloud(k, shift=5.0 * k) for k in range(4)})
    axes = draw("exploration", apart).figure.axes[0]
    assert [text.get_text() for text in axes.texts] == ["c0", "c1", "c2", "c3"]
    assert axes.get_legend() is None

    together = Made({f"c{k}": cloud(0) for k in range(5)})
    assert draw("exploration", together).figure.axes[0].get_legend() is not None

    many = Made({f"c{k}": cloud(k, shift=5.0 * k) for k in range(43)})
    axes = draw("exploration", many).figure.axes[0]
    looks = {(mark.get_color(), mark.get_marker()) for mark in lines_of(axes, 9)}
    assert len(looks) == len(axes.get_legend().get_texts()) == 43
