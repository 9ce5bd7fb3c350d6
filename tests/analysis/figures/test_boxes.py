"""Figures 3 A to C and the boxes of any study: which box stands where, what is marked, what is refused."""

import numpy as np
import pytest
from matplotlib.patches import PathPatch
from study.toy import outcome, toy

from wobblesim.analysis.comparison import compare
from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures import boxes_condition
from wobblesim.analysis.figures.boxplot import box_of
from wobblesim.analysis.figures.registry import Choice, draw
from wobblesim.analysis.tables import load
from wobblesim.config import parse_config
from wobblesim.study.compact import compact
from wobblesim.study.execute import sweep

BASE = """
name: boxes
seeds: 0..9
robot: {kind: starfish, arms: 3, sections: 2}
learning: {epochs: 12}
wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 40}
"""  # wobbles beyond the last epoch, 11, so that the final performance differs from that of the fixed robot

FORMS = """
conditions:
  fixed: {wobble: null}
  regular-8: {wobble: {period: 8}}
  regular-5: {wobble: {period: 5}}
  paused-8: {wobble: {period: 8, upper_bound: 1.0}}
  paused-5: {wobble: {period: 5, upper_bound: 1.0}}
  shifted-8: {wobble: {period: 8, mean: 0.9, amplitude: 0.1}}
"""
AMPLITUDES = """
sweep: {wobble.dimension: [mass, stiffness], wobble.amplitude: [0.4, 0.1, 0.2]}
conditions: {fixed: {wobble: null}}
"""
TWO = "conditions: {fixed: {wobble: null}, mass: {}}"


def results_of(folder, conditions, *settings, seeds=None, simulate=toy):
    sweep(parse_config(BASE + conditions, settings, seeds), folder, simulate=simulate)
    compact(folder)  # a file a condition is read sooner than one a run
    return load(folder)


def boxes(drawing):
    """Middles of the boxes, and their colours, in the order of the table."""
    outlines = [patch for patch in drawing.figure.axes[0].patches if isinstance(patch, PathPatch)]
    middles = [
        np.mean([patch.get_path().vertices[:-1, 0].min(), patch.get_path().vertices[:, 0].max()]) for patch in outlines
    ]
    return middles, [patch.get_facecolor() for patch in outlines]


def ticks(drawing):
    axes = drawing.figure.axes[0]
    return dict(zip(axes.get_xticks().tolist(), [label.get_text() for label in axes.get_xticklabels()], strict=True))


def stars(drawing):
    return [text for text in drawing.figure.axes[0].texts if text.get_text() == "*"]


def brackets(drawing):
    return [line for line in drawing.figure.axes[0].lines if line.get_label() == "bracket"]


def title(drawing):
    return drawing.figure.get_suptitle()


@pytest.fixture(scope="module")
def periods(tmp_path_factory):
    """The paper's three forms of the wobble, small."""
    return results_of(tmp_path_factory.mktemp("periods"), FORMS)


@pytest.fixture(scope="module")
def drawn(periods):
    return draw("figure-3a", periods)


@pytest.fixture(scope="module")
def amplitudes(tmp_path_factory):
    """Two dimensions and three amplitudes."""
    return results_of(tmp_path_factory.mktemp("amplitudes"), AMPLITUDES, seeds="0..3")


# --- which box stands where ------------------------------------------------------------------------------------------


def test_figure_3a_has_periods_in_order_and_the_three_forms_side_by_side(drawn):
    assert ticks(drawn) == {0.0: "fixed", 1.0: "5", 2.0: "8"}
    table = drawn.table.set_index("condition")
    assert all(name.startswith(form) for name, form in table["form"].dropna().items())
    assert table["form"].isna().tolist() == [True, False, False, False, False, False]
    middles, colors = boxes(drawn)
    place = dict(zip(drawn.table["condition"], middles, strict=True))
    assert place["fixed"] == pytest.approx(0.0)
    assert place["regular-5"] < place["paused-5"] < 1.5 < place["regular-8"] < place["paused-8"] < place["shifted-8"]
    assert place["paused-8"] == pytest.approx(2.0)
    color = dict(zip(drawn.table["condition"], colors, strict=True))
    assert color["regular-5"] == color["regular-8"] != color["paused-8"]
    assert [text.get_text() for text in drawn.figure.legends[0].get_texts()] == ["regular", "paused", "shifted"]


def test_figure_3b_has_amplitudes_in_order_and_the_dimensions_side_by_side(amplitudes):
    drawing = draw("figure-3b", amplitudes)
    assert ticks(drawing) == {0.0: "fixed", 1.0: "0.1", 2.0: "0.2", 3.0: "0.4"}
    table = drawing.table.set_index(["wobble.dimension", "wobble.amplitude"])
    assert table.index.dropna().is_unique
    assert len(table) == 7
    middles, _ = boxes(drawing)
    place = dict(zip(table.index, middles, strict=True))
    assert 2 - place["mass", 0.2] == pytest.approx(place["stiffness", 0.2] - 2)


def test_one_dimension_needs_no_legend_and_is_named_at_the_axis(amplitudes):
    mass = tuple(name for name in amplitudes.conditions if "mass" in name)
    drawing = draw("figure-3b", amplitudes, Choice(conditions=mass))
    assert drawing.figure.axes[0].get_xlabel() == "amplitude (part of the adult's value), mass"
    assert not drawing.figure.legends
    assert ticks(drawing)[0.0] == "fixed"  # the baseline is shown though it was not asked for


def test_figure_3c_has_lengths_in_order_whatever_their_decay(tmp_path):
    ends = (
        "sweep: {wobble.end: [9, 3, 6]}\nconditions: {fixed: {wobble: null}, slow: {wobble: {end: 8, decay_start: 2}}}"
    )
    drawing = draw("figure-3c", results_of(tmp_path, ends, seeds="0..3"))
    assert ticks(drawing) == {0.0: "fixed", 1.0: "3", 2.0: "6", 3.0: "8", 4.0: "9"}
    assert drawing.table["wobble.end"].dropna().tolist() == [9, 3, 6, 8]
    assert drawing.figure.axes[0].get_xlabel() == "length of the wobble (epochs), mass"


def test_boxes_are_the_conditions_in_the_order_of_the_study(periods):
    drawing = draw("boxes", periods)
    assert list(ticks(drawing).values()) == periods.conditions == drawing.table["condition"].tolist()
    assert boxes(drawing)[0] == pytest.approx(list(ticks(drawing)))


def test_long_names_are_turned_and_short_ones_are_not(amplitudes, tmp_path):
    turned = draw("boxes", amplitudes).figure.axes[0].get_xticklabels()[0].get_rotation()
    straight = draw("boxes", results_of(tmp_path, TWO, seeds="0")).figure.axes[0].get_xticklabels()[0].get_rotation()
    assert (turned, straight) == (50, 0)


# --- the numbers -----------------------------------------------------------------------------------------------------


def test_the_table_has_the_numbers_of_each_box_and_of_each_comparison(periods, drawn):
    runs = periods.runs("condition", "performance")
    pairs = compare(periods).pairs.set_index("condition")
    for row in drawn.table.to_dict("records"):
        values = runs.loc[runs["condition"] == row["condition"], "performance"]
        box = box_of(values)
        for name in ("n", "q1", "median", "q3", "whisker_low", "whisker_high", "median_low", "median_high"):
            assert row[name] == getattr(box, name)
        assert [float(value) for value in row["outliers"].split(";") if value] == box.outliers.tolist()
        assert row["n_outliers"] == len(box.outliers)
        if row["condition"] == "fixed":
            assert np.isnan([row["p_wilcoxon"], row["p_holm"]]).all()
        else:
            assert (row["p_wilcoxon"], row["p_holm"]) == (
                pairs["p"][row["condition"]],
                pairs["p_holm"][row["condition"]],
            )


def test_the_family_of_the_correction_is_what_is_shown(periods):
    shown = Choice(conditions=("regular-5", "regular-8"))
    table = draw("figure-3a", periods, shown).table.set_index("condition")
    expected = compare(periods, conditions=shown.conditions).pairs.set_index("condition")["p_holm"]
    assert table["p_holm"].dropna().to_dict() == expected.to_dict()


# --- significance ----------------------------------------------------------------------------------------------------


def test_a_star_stands_above_each_box_that_differs_and_above_no_other(periods, drawn):
    significant = compare(periods).pairs.set_index("condition")["significant"]
    assert 0 < significant.sum() < len(significant)
    middles = dict(zip(drawn.table["condition"], boxes(drawn)[0], strict=True))
    expected = sorted(middles[name] for name in significant.index[significant])
    assert sorted(text.xy[0] for text in stars(drawn)) == pytest.approx(expected)
    assert not brackets(drawn)
    assert "*: differs from fixed (Wilcoxon's signed-rank test, p < 0.01 after Holm's correction)" in title(drawn)


def test_a_star_stands_above_all_marks_of_its_box(drawn):
    middles = np.array(boxes(drawn)[0])
    for star in stars(drawn):
        row = drawn.table.iloc[np.abs(middles - star.xy[0]).argmin()]
        highest = max([row["whisker_high"], *(float(value) for value in row["outliers"].split(";") if value)])
        assert star.xy[1] >= highest


def test_few_conditions_have_brackets_to_the_baseline_one_above_the_other(periods):
    drawing = draw("figure-3a", periods, Choice(conditions=("regular-5", "regular-8", "paused-5")))
    middles = dict(zip(drawing.table["condition"], boxes(drawing)[0], strict=True))
    significant = drawing.table.set_index("condition")["p_holm"] < 0.01
    ends = [(line.get_xdata()[0], line.get_xdata()[-1]) for line in brackets(drawing)]
    assert {start for start, _ in ends} == {middles["fixed"]}
    expected = sorted(middles[name] for name in significant.index[significant])
    assert sorted(end for _, end in ends) == pytest.approx(expected)
    heights = [line.get_ydata()[1] for line in brackets(drawing)]
    assert heights == sorted(set(heights))
    assert len(stars(drawing)) == len(heights) >= 1
    assert min(heights) > drawing.table["whisker_high"].max()
    assert max(heights) < drawing.figure.axes[0].get_ylim()[1]


def test_another_baseline_is_compared_with_and_dashed(periods):
    drawing = draw("boxes", periods, Choice(baseline="paused-5"))
    table = drawing.table.set_index("condition")
    assert table.index[table["p_holm"].isna()].tolist() == ["paused-5"]
    dashed = [
        line for line in drawing.figure.axes[0].lines if line.get_linestyle() == "--" and len(line.get_ydata()) == 2
    ]
    assert table["median"]["paused-5"] in [line.get_ydata()[0] for line in dashed]
    assert "dashed: median of paused-5" in title(drawing)


def test_where_no_difference_could_be_significant_the_title_says_so(tmp_path):
    drawing = draw("boxes", results_of(tmp_path, TWO, seeds="0..3"))
    assert not stars(drawing)
    assert "too few pairs to tell any from fixed" in title(drawing)
    assert "too few for confidence of the median" in title(drawing)


def test_where_nothing_differs_the_title_says_so(tmp_path):
    drawing = draw("boxes", results_of(tmp_path, TWO, "wobble.end=1"))
    assert not stars(drawing)
    assert "none differs from fixed" in title(drawing)


# --- what has no score -----------------------------------------------------------------------------------------------


def light_diverges(body, behaviours, *, morphology, **settings):
    """Trials of a robot that is too light all diverge."""
    trials = toy(body, behaviours, morphology=morphology, **settings)
    return (
        trials if morphology.mass > 0.85 else outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))
    )


def test_runs_without_a_score_are_counted_below_an_empty_place(tmp_path):
    results = results_of(tmp_path, TWO, "learning.epochs=9", seeds="0..3", simulate=light_diverges)
    drawing = draw("boxes", results)
    lost = drawing.table.set_index("condition").loc["mass"]
    assert (lost["n"], lost["excluded"], lost["n_outliers"]) == (0, 4, 0)
    assert np.isnan(lost[["median", "p_holm"]].astype(float)).all()
    assert len(boxes(drawing)[0]) == 1
    assert [(text.get_text(), text.xy[0]) for text in drawing.figure.axes[0].texts] == [("×4", 1.0)]
    assert "×: runs without a score, left out" in title(drawing)


def test_a_baseline_without_a_score_has_no_line(tmp_path):
    results = results_of(tmp_path, TWO, "learning.epochs=9", seeds="0..3", simulate=light_diverges)
    drawing = draw("boxes", results, Choice(baseline="mass"))
    assert drawing.table["p_wilcoxon"].isna().all()
    assert "dashed" not in title(drawing)


def test_one_condition_with_one_run_is_a_line_without_a_comparison(tmp_path):
    drawing = draw("boxes", results_of(tmp_path, "conditions: {fixed: {wobble: null}}", seeds="7"))
    row = drawing.table.iloc[0]
    assert row["q1"] == row["median"] == row["q3"]
    assert "fixed" not in title(drawing)


# --- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["figure-3a", "figure-3b", "figure-3c"])
def test_a_study_that_does_not_vary_what_is_shown_is_refused(name, tmp_path):
    setting = {"figure-3a": "period", "figure-3b": "amplitude", "figure-3c": "end"}[name]
    with pytest.raises(FigureError, match=rf"wobble\.{setting} does not vary among the conditions shown; draw `boxes`"):
        draw(name, results_of(tmp_path, TWO, seeds="0"))


def test_a_setting_that_varies_beside_is_named(tmp_path):
    both = "conditions: {fixed: {wobble: null}, slow: {wobble: {period: 8}}, mild: {wobble: {amplitude: 0.1}}}"
    results = results_of(tmp_path, both, seeds="0")
    with pytest.raises(FigureError, match=r"wobble\.period varies beside wobble\.amplitude; choose conditions"):
        draw("figure-3b", results)
    with pytest.raises(FigureError, match=r"wobble\.amplitude varies beside wobble\.period"):
        draw("figure-3a", results)


def test_an_upper_bound_that_one_of_two_has_varies(tmp_path):
    bound = "conditions: {high: {}, low: {wobble: {amplitude: 0.1}}, cut: {wobble: {amplitude: 0.2, upper_bound: 1.0}}}"
    with pytest.raises(FigureError, match=r"wobble\.upper_bound varies beside wobble\.amplitude"):
        draw("figure-3b", results_of(tmp_path, bound, seeds="0"))


def test_another_setting_than_of_the_wobble_may_not_vary_either(tmp_path):
    short = "sweep: {wobble.amplitude: [0.1, 0.2]}\nconditions: {fixed: {wobble: null, trial: {duration: 5}}}"
    with pytest.raises(FigureError, match=r"trial\.duration varies beside wobble\.amplitude"):
        draw("figure-3b", results_of(tmp_path, short, seeds="0"))


def test_two_conditions_at_one_place_are_named(tmp_path):
    decays = "conditions: {late: {}, early: {wobble: {decay_start: 2}}, short: {wobble: {end: 9}}}"
    with pytest.raises(FigureError, match="late and early have the same length of the wobble and would be one box"):
        draw("figure-3c", results_of(tmp_path, decays, seeds="0"))


def test_more_boxes_than_fit_are_refused_and_many_are_a_wider_picture(periods, monkeypatch):
    monkeypatch.setattr(boxes_condition, "INCHES_A_BOX", 2.0)
    assert draw("boxes", periods).figure.get_figwidth() == 13.0
    monkeypatch.setattr(boxes_condition, "MOST_BOXES", 5)
    with pytest.raises(FigureError, match="6 are more than the 5 that fit; choose some with --condition"):
        draw("boxes", periods)
