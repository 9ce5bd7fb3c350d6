"""Figure 2 A: every trial of a run is a dot, what diverged is a tick, and the wobble stands beneath."""

import numpy as np
import pytest
from study.toy import outcome, study, toy

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures import scatter
from wobblesim.analysis.figures.registry import Choice, draw
from wobblesim.analysis.tables import load
from wobblesim.study.compact import compact
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep


def results_of(folder, *settings, seeds=None, simulate=toy):
    sweep(study(*settings, seeds=seeds), folder, simulate=simulate)
    return load(folder)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return results_of(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def drawing(results):
    return draw("figure-2a", results, Choice(seed=2))


def lines(axes, label):
    return [line for line in axes.lines if line.get_label() == label]


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_each_trial_is_a_dot_in_the_panel_of_its_condition(results, drawing):
    trials = results.trials("condition", "seed", "epoch", "performance")
    for axes, condition in zip(drawing.figure.axes, ("fixed", "mass"), strict=False):
        mine = trials[(trials["condition"] == condition) & (trials["seed"] == 2)].dropna()
        (cloud,) = lines(axes, "trials")
        assert axes.get_title(loc="left").strip() == condition
        assert cloud.get_xdata().tolist() == mine["epoch"].tolist()
        assert cloud.get_ydata().tolist() == mine["performance"].tolist()


def test_trials_that_diverged_are_ticks_at_the_lower_edge_and_counted(drawing):
    for axes, condition in zip(drawing.figure.axes, ("fixed", "mass"), strict=False):
        mine = drawing.table[drawing.table["condition"] == condition]
        lost = mine[mine["status"] == "diverged"]
        (ticks,) = lines(axes, "diverged")
        assert ticks.get_xdata().tolist() == lost["epoch"].tolist()
        assert set(ticks.get_ydata()) == {0.0}
        assert ticks.get_transform() == axes.get_xaxis_transform()
        assert f"240 trials, {len(lost)} diverged" in texts(drawing.figure)
    assert "ticks at the lower edge: diverged" in drawing.figure.get_suptitle()


def test_the_table_has_a_row_a_trial_with_the_factor_of_its_epoch(results, drawing):
    table = drawing.table
    assert list(table) == ["condition", "seed", "epoch", "slot", "performance", "status", "mass"]
    assert len(table) == 2 * 12 * 20
    assert set(table["seed"]) == {2}
    assert table["performance"].isna().equals(table["status"] == "diverged")
    factors = results.epochs("condition", "seed", "epoch", "mass").set_index(["condition", "seed", "epoch"])["mass"]
    assert table["mass"].tolist() == [
        factors[key] for key in zip(table["condition"], table["seed"], table["epoch"], strict=True)
    ]


def test_the_wobble_stands_beneath_over_the_same_epochs(results, drawing):
    cloud, wobble = drawing.figure.axes[1], drawing.figure.axes[3]
    (factor,) = lines(wobble, "mass")
    epochs = results.epochs("condition", "seed", "mass")
    expected = epochs[(epochs["condition"] == "mass") & (epochs["seed"] == 2)]["mass"]
    assert factor.get_ydata().tolist() == expected.tolist()
    assert cloud.get_xlim() == wobble.get_xlim() == (-0.5, 11.5)
    assert cloud.get_ylim() == drawing.figure.axes[0].get_ylim()
    assert drawing.figure.axes[2].get_ylabel() == "mass\nfactor"


def test_the_end_of_the_wobble_is_dashed_in_both_panels_of_its_condition(drawing):
    dashed = [
        [line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--"] for axes in drawing.figure.axes
    ]
    assert dashed == [[], [6.0], [], [6.0]]


def test_what_wobbles_is_named_above_where_conditions_differ_in_it(tmp_path):
    both = "conditions.both={wobble: {dimension: [mass, size], amplitude: 0.2, period: 5, end: 6}}"
    stiff = "conditions.stiff={wobble: {dimension: stiffness, amplitude: 0.2, period: 5, end: 6}}"
    drawing = draw("figure-2a", results_of(tmp_path, both, stiff, seeds="0"))
    assert [name for name in ("mass", "mass and size", "stiffness") if name in texts(drawing.figure)] == [
        "mass", "mass and size", "stiffness"
    ]  # fmt: skip
    assert {"mass", "stiffness", "size"} <= set(drawing.table)
    assert "gravity" not in drawing.table


def test_a_fixed_robot_alone_has_a_flat_line(tmp_path):
    drawing = draw("figure-2a", results_of(tmp_path, seeds="0"), Choice(conditions=("fixed",)))
    assert drawing.figure.axes[1].get_ylim() == (0.9, 1.1)
    assert list(drawing.table) == ["condition", "seed", "epoch", "slot", "performance", "status"]


def test_a_run_whose_trials_all_diverge_is_ticks_only(tmp_path):
    def explode(body, behaviours, **_):
        return outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))

    drawing = draw("figure-2a", results_of(tmp_path, seeds="0..1", simulate=explode))
    assert "240 trials, 240 diverged" in texts(drawing.figure)
    assert drawing.table["performance"].isna().all()
    assert "seed 0" in drawing.figure.get_suptitle()


def test_more_conditions_than_a_row_holds_go_on_below(tmp_path):
    names = [
        f"conditions.c{n}={{wobble: {{dimension: mass, amplitude: 0.{n}, period: 5, end: 6}}}}" for n in (1, 2, 4, 5)
    ]
    figure = draw("figure-2a", results_of(tmp_path, *names, seeds="0")).figure
    assert len(figure.axes) == 2 * 6
    tops = {round(axes.get_subplotspec().rowspan.start) for axes in figure.axes}
    assert tops == {0, 1, 2, 3}


# --- which run -------------------------------------------------------------------------------------------------------


def test_the_run_is_that_with_the_median_gain_over_the_baseline(results):
    scores = results.runs("condition", "seed", "performance").pivot(index="seed", columns="condition")["performance"]
    gain = (scores["mass"] - scores["fixed"]).sort_values()
    assert Choice().typical_seed(results, ["fixed", "mass"]) == gain.index[1]  # the lower of the two in the middle
    assert Choice().typical_seed(results, ["fixed"]) == scores["fixed"].sort_values().index[1]
    assert f"seed {gain.index[1]}" in draw("figure-2a", results).figure.get_suptitle()


def test_the_run_is_the_one_asked_for_or_refused_if_it_is_not_there(results):
    assert Choice(seed=3).typical_seed(results, ["fixed", "mass"]) == 3
    with pytest.raises(StoreError, match="no run of fixed with seed 9; the nearest is 3"):
        draw("figure-2a", results, Choice(seed=9))


def test_conditions_without_a_common_seed_are_refused(tmp_path):
    results = results_of(tmp_path, seeds="0..1")
    del results.manifest.runs["fixed", 0], results.manifest.runs["mass", 1]
    with pytest.raises(FigureError, match="no seed has a run in every condition shown"):
        draw("figure-2a", results)


def test_of_a_compacted_study_the_same_run_is_read(results, tmp_path):
    compacted = results_of(tmp_path)
    compact(tmp_path)
    compacted = load(tmp_path)
    assert draw("figure-2a", compacted, Choice(seed=2)).table.equals(draw("figure-2a", results, Choice(seed=2)).table)


# --- what is refused -------------------------------------------------------------------------------------------------


def test_a_study_that_kept_no_trials_is_refused_with_the_setting_that_keeps_them(tmp_path):
    with pytest.raises(FigureError, match="every trial is a dot, and fixed and mass kept none; set `log: trials`"):
        draw("figure-2a", results_of(tmp_path, "log=epochs", seeds="0"))


def test_more_panels_than_can_be_read_are_refused(results, monkeypatch):
    monkeypatch.setattr(scatter, "MOST_PANELS", 1)
    with pytest.raises(FigureError, match="2 are more than the 1 that fit; choose some with --condition"):
        draw("figure-2a", results)
