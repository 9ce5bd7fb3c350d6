"""Lines from the baseline's run to the condition's: of the same seed, in the right colour, none lost in silence."""

import numpy as np
import pytest
from study.toy import outcome, study, toy

from wobblesim.analysis.comparison import compare
from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.pairs import COLORS, wrapped
from wobblesim.analysis.figures.registry import Choice, draw
from wobblesim.analysis.tables import load
from wobblesim.config import parse_config
from wobblesim.study.execute import sweep

STUDY = """
name: toy
robot: {kind: starfish, arms: 3, sections: 2}
learning: {epochs: 12}
"""
FIXED = "conditions: {fixed: {wobble: null}}\n"
MASS = "conditions: {mass: {wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 6}}}\n"


def rugged(body, behaviours, *, morphology, **_):
    """A task whose hills move with the mass, so that runs of a seed part."""
    half = behaviours.shape[1] // 2
    turns = behaviours[:, half:] - 0.8 * (morphology.mass - 1.0)
    return outcome((behaviours[:, :half] * np.cos(2 * np.pi * turns)).sum(axis=1), diverged=behaviours[:, 0] > 0.97)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Seeds 0 to 4 of the baseline and 2 to 6 of the condition: only three of each make pairs."""
    folder = tmp_path_factory.mktemp("pairs")
    sweep(parse_config(STUDY + FIXED, (), "0..4"), folder, simulate=rugged)
    sweep(parse_config(STUDY + MASS, (), "2..6"), folder, simulate=rugged)
    return load(folder)


@pytest.fixture(scope="module")
def drawn(results):
    return draw("pairs", results)


def score(results):
    runs = results.runs("condition", "seed", "performance")
    return {(row.condition, row.seed): row.performance for row in runs.itertuples()}


def segments(axes):
    return np.array([[point[1] for point in line] for line in axes.collections[0].get_segments()])


def test_a_line_joins_the_runs_of_one_seed(results, drawn):
    known, pairs = score(results), drawn.table[drawn.table["kind"] == "pair"]
    assert pairs["seed"].tolist() == [2, 3, 4]
    expected = [[known["fixed", seed], known["mass", seed]] for seed in (2, 3, 4)]
    assert pairs[["baseline_performance", "performance"]].to_numpy().tolist() == expected
    assert segments(drawn.figure.axes[0]).tolist() == expected
    # Rows in their order would join seed 0 with seed 2, and be seen here.
    in_order = [[known["fixed", seed], known["mass", seed + 2]] for seed in range(3)]
    assert expected != in_order


def test_seeds_that_make_no_pair_are_named_with_the_reason_and_counted(drawn):
    missing = drawn.table[drawn.table["kind"] == "missing"]
    assert dict(zip(missing["seed"], missing["change"], strict=True)) == {
        0: "no run of mass", 1: "no run of mass", 5: "no run of fixed", 6: "no run of fixed",
    }  # fmt: skip
    assert drawn.figure.axes[0].get_title(loc="left").startswith("3 pairs, 4 missing")


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    folder = tmp_path_factory.mktemp("many")
    sweep(study("log=epochs", "learning.epochs=20", seeds="0..19"), folder, simulate=rugged)
    return load(folder)


def test_rising_and_falling_lines_are_counted_and_have_two_colours(many):
    drawing, known = draw("pairs", many), score(many)
    differences = np.array([known["mass", seed] - known["fixed", seed] for seed in range(20)])
    rises, falls = int((differences > 0).sum()), int((differences < 0).sum())
    assert min(rises, falls) > 0
    row = drawing.table[drawing.table["kind"] == "condition"].iloc[0]
    assert (row["rises"], row["falls"], row["n_pairs"]) == (rises, falls, 20)
    axes = drawing.figure.axes[0]
    assert f"20 pairs\n{rises} rise, {falls} fall" in axes.get_title(loc="left")
    rising = np.diff(segments(axes))[:, 0] > 0
    colors = axes.collections[0].get_colors()
    assert len({tuple(color) for color in colors[rising]}) == len({tuple(color) for color in colors[~rising]}) == 1
    assert tuple(colors[rising][0]) != tuple(colors[~rising][0])
    assert len(set(COLORS.values())) == 3


def test_the_thick_line_is_the_mean_of_the_pairs_and_the_test_is_that_of_the_comparison(many):
    drawing, pair = draw("pairs", many), compare(many).pairs.iloc[0]
    row = drawing.table[drawing.table["kind"] == "condition"].iloc[0]
    line = drawing.figure.axes[0].get_lines()[0]
    assert line.get_ydata() == pytest.approx(segments(drawing.figure.axes[0]).mean(axis=0), rel=1e-14)
    assert row[["p_holm", "effect", "difference", "significant"]].tolist() == [
        pair["p_holm"], pair["effect"], pair["difference"], pair["significant"],
    ]  # fmt: skip
    # measured 1e-16
    assert row["performance"] - row["baseline_performance"] == pytest.approx(row["difference"], abs=1e-14)


def test_equal_runs_neither_rise_nor_fall(tmp_path):
    # The toy's order of behaviours does not depend on the mass: the wobbled run ends as the fixed one.
    sweep(study("log=epochs", seeds="0..2"), tmp_path, simulate=toy)
    drawing = draw("pairs", load(tmp_path))
    assert drawing.table["change"].tolist() == ["equal", "equal", "equal", ""]
    assert "3 pairs\n0 rise, 0 fall" in drawing.figure.axes[0].get_title(loc="left")


def test_each_condition_has_a_panel_also_one_without_a_pair(tmp_path):
    def fails_when_light(body, behaviours, *, morphology, **settings):
        if morphology.size < 1.0:
            return outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))
        return rugged(body, behaviours, morphology=morphology, **settings)

    lost = "conditions.lost={wobble: {dimension: size, amplitude: 0.3, period: 4, end: 99}}"
    sweep(study("log=epochs", lost, seeds="0..2"), tmp_path, simulate=fails_when_light)
    results = load(tmp_path)
    drawing = draw("pairs", results)
    titles = [axes.get_title(loc="left") for axes in drawing.figure.axes]
    assert titles[1] == "0 pairs, 3 missing\n0 rise, 0 fall"
    reasons = drawing.table[drawing.table["kind"] == "missing"]["change"]
    assert set(reasons) == {"no score in lost"}
    with pytest.raises(FigureError, match="no seed has a score in both fixed and another condition"):
        draw("pairs", results, Choice(conditions=("lost",)))


def test_a_condition_alone_has_no_pairs(results):
    with pytest.raises(FigureError, match="no condition beside fixed"):
        draw("pairs", results, Choice(conditions=("fixed",)))


def test_long_names_are_broken_and_stay_whole():
    name = "dimension-mass_period-25_amplitude-0.05"
    assert wrapped(name).replace("\n", "") == name
    assert wrapped(name) == "dimension-mass_\nperiod-25_\namplitude-0.05"
    assert wrapped("x" * 40).replace("\n", "") == "x" * 40
