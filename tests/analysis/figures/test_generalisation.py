"""A learnt gait on other robots: the very trials of the study, and of no other robot than the one that is meant."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from study.toy import outcome, study, toy

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures import generalisation
from wobblesim.analysis.figures.generalisation import points
from wobblesim.analysis.figures.registry import Choice, draw, lacking
from wobblesim.analysis.generalise import factors_of, generalise, spans
from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import load
from wobblesim.physics.simulate import simulate
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology
from wobblesim.robot.starfish import starfish
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep

SHORT = ("log=epochs", "learning.epochs=8", "learning.population=6", "learning.parents=2", "trial.duration=1.5")
SIZE = "conditions.size={wobble: {dimension: [size, gravity], amplitude: 0.2, period: 4, end: 99, upper_bound: 1.1}}"


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """A tiny robot that has learnt: fixed, with a mass that wobbled until epoch 6, and one that wobbles to the end."""
    folder = tmp_path_factory.mktemp("real")
    sweep(study(*SHORT, SIZE, seeds="0..2"), folder)
    return load(folder)


@pytest.fixture(scope="module")
def tried(real):
    return generalise(real)


def final(results):
    runs = results.runs("condition", "seed", "performance", "genotype")
    return {(row.condition, row.seed): row for row in runs.itertuples()}


def test_on_the_adult_every_gait_performs_as_stored_bit_for_bit(real, tried):
    known = final(real)
    adult = tried[(tried["factor"] == 1.0) & (tried["condition"] != "size")]
    assert len(adult) == 9  # three runs of mass, and of fixed in both dimensions
    for row in adult.itertuples():
        assert row.performance == row.stored == known[row.condition, row.seed].performance


def test_a_robot_that_wobbled_to_the_end_performs_as_stored_on_its_last_robot(real):
    # Epoch 7 of a period of 4: the trough.
    found = generalise(real, ["size"], factors=[0.8, 1.0])
    known = final(real)
    assert found["dimension"].unique().tolist() == ["size+gravity"]
    for row in found.itertuples():
        if row.factor == 0.8:
            assert row.performance == row.stored == known["size", row.seed].performance
        else:
            assert np.isnan(row.stored)


def test_another_factor_is_a_trial_of_that_robot(real):
    found = generalise(real, ["fixed"], factors=[2.0], duration=1.0)
    robot = starfish(arms=3, sections=2)
    for dimension, morphology in {
        "mass": Morphology(mass=2.0),
        "size+gravity": Morphology(size=2.0, gravity=2.0),
    }.items():
        mine = found[found["dimension"] == dimension]
        behaviours = [final(real)["fixed", seed].genotype for seed in mine["seed"]]
        trials = simulate(robot, behaviours, morphology=morphology, gait=Gait(), duration=1.0)
        assert mine["performance"].tolist() == trials.displacement.tolist()
        assert mine["status"].tolist() == trials.status.tolist()
    assert found["stored"].isna().all()


def test_a_condition_is_tried_where_it_wobbles_and_a_fixed_robot_everywhere(tried):
    places = tried.groupby(["dimension", "condition"], observed=True).size()
    assert set(places.index) == {
        ("mass", "fixed"), ("mass", "mass"), ("size+gravity", "fixed"), ("size+gravity", "size"),
    }  # fmt: skip
    assert (places == 3 * 19).all()
    ends = tried.groupby("dimension")["factor"].agg(["min", "max"])
    assert ends.loc["mass"].tolist() == pytest.approx([0.7, 1.3], rel=1e-15)
    assert ends.loc["size+gravity"].tolist() == pytest.approx([0.8, 1.1], rel=1e-15)


def test_the_range_is_that_of_all_wobbles_of_a_dimension_and_holds_the_adult():
    columns = ["condition", "wobble.dimension", "wobble.mean", "wobble.amplitude", "wobble.upper_bound"]
    rows = [
        ("fixed", None, np.nan, np.nan, np.nan),
        ("a", "mass", 1.0, 0.25, np.nan),
        ("b", "mass", 1.0, 0.5, 1.0),
        ("c", "size", 0.75, 0.125, np.nan),
        ("d", "gravity", 1.0, 0.0, np.nan),
    ]
    assert spans(pd.DataFrame(rows, columns=columns)) == {"mass": (0.5, 1.25), "size": (0.625, 1.0)}
    with pytest.raises(FigureError, match="no condition that wobbles"):
        spans(pd.DataFrame(rows[:1], columns=columns))


@pytest.mark.parametrize(("low", "high"), [(0.5, 1.5), (0.9, 1.0), (1.0, 1.3), (0.999, 3.0), (0.05, 1.001)])
def test_factors_hold_both_ends_and_the_adult_and_rise(low, high):
    factors = factors_of(low, high)
    assert (factors[0], factors[-1], len(factors)) == (low, high, 19)
    assert (factors == 1.0).sum() == 1
    assert (np.diff(factors) > 0).all()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    sweep(study("log=epochs", seeds="0..4"), folder, simulate=toy)
    return load(folder)


def heavy_ones_diverge(body, behaviours, *, morphology, **settings):
    trials = toy(body, behaviours, morphology=morphology, **settings)
    lost = (morphology.mass > 1.2) & (np.arange(len(behaviours)) % 2 == 0)
    return outcome(np.nan_to_num(trials.displacement), lost)


def test_a_point_is_the_mean_over_the_runs_without_those_that_diverged(made):
    tried = generalise(made, simulate=heavy_ones_diverge)
    table = points(tried)
    for row in table.itertuples():
        mine = tried[(tried["condition"] == row.condition) & (tried["factor"] == row.factor)]
        scores = mine["performance"].dropna().to_numpy()
        expected = mean_of(scores)
        assert row.n == len(scores) == 5 - row.diverged
        assert row.mean == pytest.approx(scores.mean(), rel=1e-12)
        assert (row.low, row.high) == (expected.mean - expected.half_width, expected.mean + expected.half_width)
    lost = table[table["diverged"] > 0]
    assert lost["factor"].min() > 1.2
    assert lost["diverged"].sum() == (tried["status"] == "diverged").sum() > 0


def test_runs_without_a_score_have_learnt_no_gait(tmp_path):
    def fails_when_light(body, behaviours, *, morphology, **settings):
        if morphology.mass < 0.9:
            return outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))
        return toy(body, behaviours, morphology=morphology, **settings)

    # Epoch 8 of a period of 5 is below the middle.
    config = study("log=epochs", "learning.epochs=9", "conditions.mass.wobble.end=20", seeds="0..1")
    sweep(config, tmp_path, simulate=fails_when_light)
    results = load(tmp_path)
    assert generalise(results, simulate=toy)["condition"].unique().tolist() == ["fixed"]
    assert len(generalise(results, ["mass"], simulate=toy)) == 0
    with pytest.raises(FigureError, match="no run that is shown has a score"):
        draw("generalisation", results, Choice(conditions=("mass",)))


def test_only_some_runs_can_be_tried(made):
    assert generalise(made, seeds=[1, 3], simulate=toy)["seed"].unique().tolist() == [1, 3]
    assert generalise(made, most=2, simulate=toy)["seed"].unique().tolist() == [0, 1]
    with pytest.raises(StoreError, match="has no condition 'masses'; did you mean mass"):
        generalise(made, ["masses"])
    with pytest.raises(ValueError, match="a factor must be finite and above 0, got -1"):
        generalise(made, factors=[1.0, -1.0])
    with pytest.raises(ValueError, match="a duration must be finite and above 0, got 0"):
        generalise(made, duration=0.0)
    with pytest.raises(ValueError, match="give at least one"):
        generalise(made, factors=[])


def test_a_robot_that_cannot_be_simulated_is_named(made):
    def refuses(*_, **__):
        raise ValueError("dt is too large")

    with pytest.raises(FigureError, match=r"robot of fixed, mass cannot be simulated with 0\.7 times its mass: dt is"):
        generalise(made, simulate=refuses)


@dataclass
class Old:
    """Results of a version without the last behaviour."""

    folder: Path = Path("results/old")
    conditions: tuple[str, ...] = ("fixed",)

    def runs(self, *_):
        return pd.DataFrame({"condition": ["fixed"], "performance": [1.0]})


def test_results_that_kept_no_last_behaviour_are_refused():
    assert "results/old is of an older version" in (lacking("generalisation", Old()) or "")


# --- the picture ---------------------------------------------------------------------------------------------------


def test_the_picture_has_a_panel_a_dimension_and_thick_lines_where_the_robot_has_been(real, tried):
    drawing = draw("generalisation", real)
    assert drawing.table.equals(points(tried))
    mass, size = drawing.figure.axes
    assert mass.get_xlabel() == "factor on the adult's mass"
    assert size.get_xlabel() == "factor on the adult's size and gravity"
    assert mass.get_ylabel() == "performance of the learnt gait\n(body lengths in 1.5 s)"
    thick = {line.get_color(): line.get_xdata() for line in size.get_lines() if line.get_linewidth() == 2.6}
    (fixed, wobbled) = thick.values()
    assert fixed.tolist() == [1.0]
    assert (wobbled[0], wobbled[-1]) == (0.8, 1.1)
    assert [text.get_text() for text in mass.texts] == ["adult", "fixed", "mass"]
    assert "mean of 3 runs a condition, band: 99 % confidence" in drawing.figure.get_suptitle()


def test_the_picture_says_what_it_leaves_out_and_what_comes_out_otherwise(made, monkeypatch):
    monkeypatch.setattr(generalisation, "MOST_RUNS", 3)
    monkeypatch.setattr(
        generalisation, "generalise", lambda *given, **named: generalise(*given, **named, simulate=heavy_ones_diverge)
    )
    drawing = draw("generalisation", made)
    said = drawing.figure.get_suptitle().replace("\n", " ")
    lost = drawing.table["diverged"].sum()
    assert "mean of 3 runs a condition, the first of 5" in said
    assert f"cross: {lost} of 114 trials diverged and are left out" in said
    assert "otherwise" not in said
    crosses = [line for line in drawing.figure.axes[0].get_lines() if line.get_marker() == "x"]
    assert sum(len(line.get_xdata()) for line in crosses) == (drawing.table["diverged"] > 0).sum() > 0


def test_the_picture_says_if_stored_trials_come_out_otherwise(made, monkeypatch):
    def last_bit_off(body, behaviours, **settings):
        place = np.nan_to_num(toy(body, behaviours, **settings).displacement)
        return outcome(np.nextafter(place, 9.0), np.zeros(len(place), dtype=bool))

    monkeypatch.setattr(
        generalisation, "generalise", lambda *given, **named: generalise(*given, **named, simulate=last_bit_off)
    )
    said = draw("generalisation", made).figure.get_suptitle().replace("\n", " ")
    assert "10 of 10 stored trials come out otherwise: other version or processor" in said
