"""The map of period and amplitude: each cell its own mean, marked where the statistics say so, none made up."""

import itertools

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from study.toy import outcome, toy

from wobblesim.analysis.comparison import compare
from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.heat_map import ink_on
from wobblesim.analysis.figures.registry import Choice, draw, lacking
from wobblesim.analysis.figures.style import DIVERGING, SEQUENTIAL
from wobblesim.analysis.tables import load
from wobblesim.config import parse_config
from wobblesim.study.execute import sweep

# The wobble goes on to the last epoch, in which the toy's score is proportional to the mass: epoch 7 is at the trough
# of a period of 4 epochs, above the middle of one of 5, and in the middle of one of 7: the adult's score.
BASE = """
name: toy
robot: {kind: starfish, arms: 3, sections: 2}
learning: {epochs: 8}
wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 20}
"""
GRID = "sweep: {wobble.period: [4, 5, 7], wobble.amplitude: [0.1, 0.3]}\n"
FIXED = "conditions: {fixed: {wobble: null}}\n"


def results_of(folder, text, seeds, simulate=toy):
    sweep(parse_config(BASE + text, (), seeds), folder, simulate=simulate)
    return load(folder)


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    """Six wobbles beside a fixed robot, enough seeds for a significant difference."""
    return results_of(tmp_path_factory.mktemp("grid"), GRID + FIXED, "0..11")


@pytest.fixture(scope="module")
def drawn(grid):
    return draw("heat-map", grid)


def scores(results):
    runs = results.runs("condition", "seed", "performance")
    return {(row.condition, row.seed): row.performance for row in runs.itertuples()}


def stars(axes):
    return {(line.get_xdata()[0], line.get_ydata()[0]) for line in axes.get_lines() if line.get_marker() == "*"}


def test_a_cell_is_the_mean_difference_of_runs_with_the_same_seed(grid, drawn):
    table, score = drawn.table, scores(grid)
    places = list(zip(table["amplitude"], table["period"], strict=True))
    assert places == list(itertools.product((0.1, 0.3), (4.0, 5.0, 7.0)))
    for row in table.itertuples():
        assert row.condition == f"period-{row.period:g}_amplitude-{row.amplitude:g}"
        differences = [score[row.condition, seed] - score["fixed", seed] for seed in range(12)]
        # measured 4e-16
        assert row.shown == row.difference == pytest.approx(sum(differences) / 12, abs=1e-14)
        assert row.mean == pytest.approx(sum(score[row.condition, seed] for seed in range(12)) / 12, rel=1e-14)


def test_the_starred_cells_are_those_that_the_comparison_finds(grid, drawn):
    table, pairs = drawn.table.set_index("condition"), compare(grid, "fixed").pairs.set_index("condition")
    assert 0 < pairs["significant"].sum() < 6
    assert table["significant"].to_dict() == pairs["significant"].to_dict()
    assert table["p_holm"].to_dict() == pairs["p_holm"].to_dict()
    marked = drawn.table[drawn.table["significant"]]
    across, up = {4.0: 0, 5.0: 1, 7.0: 2}, {0.1: 0, 0.3: 1}
    assert stars(drawn.figure.axes[0]) == {(across[row.period], up[row.amplitude]) for row in marked.itertuples()}
    assert "star: p < 0.01 (Wilcoxon, Holm over 6 conditions)" in drawn.figure.get_suptitle().replace("\n", " ")


def test_the_colours_of_differences_are_centred_at_none(drawn):
    axes, bar = drawn.figure.axes
    largest = drawn.table["shown"].abs().max()
    for cell, row in zip(axes.patches, drawn.table.itertuples(), strict=True):
        assert cell.get_facecolor() == colormaps[DIVERGING](0.5 + 0.5 * row.shown / largest)
    assert bar.get_ylabel() == "difference from fixed\n(body lengths in 60 s)"


def test_without_a_baseline_a_cell_is_the_mean(tmp_path):
    results = results_of(tmp_path, GRID, "0..2")
    drawing, score = draw("heat-map", results), scores(results)
    for row in drawing.table.itertuples():
        assert row.shown == pytest.approx(np.mean([score[row.condition, seed] for seed in range(3)]), rel=1e-14)
    assert drawing.table["difference"].isna().all()
    assert not stars(drawing.figure.axes[0])
    low, high = drawing.table["shown"].min(), drawing.table["shown"].max()
    darkest = drawing.figure.axes[0].patches[int(drawing.table["shown"].idxmin())].get_facecolor()
    assert darkest == colormaps[SEQUENTIAL](0.0)
    assert low < high
    assert "mean of 3 runs a cell" in drawing.figure.get_suptitle()


def test_a_chosen_baseline_among_the_cells_differs_by_nothing_from_itself(grid):
    table = draw("heat-map", grid, Choice(baseline="period-5_amplitude-0.1")).table.set_index("condition")
    assert table.loc["period-5_amplitude-0.1", "shown"] == 0.0
    assert not table.loc["period-5_amplitude-0.1", "significant"]
    assert (table["shown"].drop("period-5_amplitude-0.1") != 0.0).all()


def test_cells_without_a_condition_or_a_score_are_hatched_and_have_no_number(tmp_path):
    def fails_at_the_trough(body, behaviours, *, morphology, **settings):
        if morphology.mass < 0.75:
            return outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))
        return toy(body, behaviours, morphology=morphology, **settings)

    results = results_of(tmp_path, GRID + FIXED, "0..1", fails_at_the_trough)
    shown = tuple(name for name in results.conditions if name != "period-7_amplitude-0.1")
    drawing = draw("heat-map", results, Choice(conditions=shown))
    axes, table = drawing.figure.axes[0], drawing.table.set_index(["period", "amplitude"])
    assert (table.loc[(4.0, 0.3), ["runs", "excluded"]] == 2).all()
    assert table.loc[(7.0, 0.1), "condition"] == ""
    hatched = {cell.get_xy() for cell in axes.patches if cell.get_hatch()}
    assert {(-0.5, 0.5), (1.5, -0.5)} <= hatched
    assert len(axes.texts) == 6 - len(hatched) == table["shown"].notna().sum()
    assert "without a score left out; hatched: no score" in drawing.figure.get_suptitle().replace("\n", " ")


def test_each_form_and_dimension_of_the_wobble_has_a_panel(tmp_path):
    wobbles = {
        "bounded": "upper_bound: 1.0",
        "shifted": "mean: {mean}",
        "sized": "dimension: size",
        "plain": "mean: 1.0",
    }
    lines = [
        f"  {name}-{period}-{amplitude}: {{wobble: {{period: {period}, amplitude: 0.{amplitude}, "
        f"{form.format(mean=f'0.{10 - amplitude}')}}}}}\n"
        for name, form in wobbles.items()
        for period in (4, 5)
        for amplitude in (1, 2)
    ]
    drawing = draw("heat-map", results_of(tmp_path, "conditions:\n" + "".join(lines), "0"))
    titles = [axes.get_title(loc="left") for axes in drawing.figure.axes[:4]]
    assert titles == ["mass, at most 1", "mass, mean 1 − amplitude", "size", "mass"]
    assert drawing.table.groupby("panel").size().to_dict() == dict.fromkeys(titles, 4)


def test_another_setting_that_varies_parts_the_panels(tmp_path):
    results = results_of(tmp_path, GRID[:-2] + ", learning.parents: [4, 5]}\n", "0")
    panels = draw("heat-map", results).table["panel"].unique()
    assert list(panels) == ["mass, learning.parents 4", "mass, learning.parents 5"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("sweep: {wobble.period: [4, 5]}\n", "do not differ in both their period and their amplitude"),
        ("conditions: {fixed: {wobble: null}}\n", "do not differ in both their period and their amplitude"),
        (GRID + "conditions: {again: {wobble: {period: 4, amplitude: 0.1}, log: trials}}\n", "have the same wobble"),
    ],
)
def test_a_study_without_a_map_is_refused_with_a_sentence(tmp_path, text, why):
    results = results_of(tmp_path, text, "0")
    with pytest.raises(FigureError, match=why):
        draw("heat-map", results)
    assert why in (lacking("heat-map", results) or "")


@pytest.mark.parametrize("name", [DIVERGING, SEQUENTIAL])
def test_numbers_can_be_read_on_every_colour(name):
    def luminance(color):
        return np.dot(
            [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in color], (0.2126, 0.7152, 0.0722)
        )

    for color in colormaps[name](np.linspace(0.0, 1.0, 256)):
        low, high = sorted((luminance(to_rgb(ink_on(color))), luminance(color[:3])))
        assert (high + 0.05) / (low + 0.05) >= 4.5  # WCAG 2.2, contrast of text
