"""A sweep: what its rows say, what it tells, and what it does with failure."""

import numpy as np
import pytest
from study.toy import StopAfter, content, outcome, study, toy

from wobblesim.analysis.tables import load
from wobblesim.config import expand
from wobblesim.learning.run import Learner
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import read_manifest
from wobblesim.study.plan import setup


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The toy study, finished."""
    folder = tmp_path_factory.mktemp("toy")
    sweep(study(), folder, simulate=toy)
    return load(folder)


@pytest.fixture(scope="module")
def epochs():
    """What the learner itself says of seed 2 of the wobbling condition."""
    learner = Learner(setup(expand(study())[1].parameters), [2], simulate=toy)
    return [learner.advance() for _ in range(12)]


def of_seed_2(frame):
    return frame[(frame["condition"] == "mass") & (frame["seed"] == 2)].reset_index(drop=True)


def test_the_rows_of_trials_are_what_the_learner_tried(results, epochs):
    trials = of_seed_2(results.trials())
    assert trials["epoch"].tolist() == [epoch for epoch in range(12) for _ in range(20)]
    assert trials["slot"].tolist() == list(range(20)) * 12
    for name in ("performance", "diverged_at", "parent", "reused", "status", "dt", "bound", "limited"):
        learned = np.concatenate([getattr(epoch, name)[0] for epoch in epochs])
        assert trials[name].to_numpy().astype(learned.dtype).tobytes() == learned.tobytes(), name


def test_the_rows_of_behaviours_are_their_genotypes_bit_for_bit(results, epochs):
    stored = np.stack(of_seed_2(results.behaviours())["genotype"])
    assert stored.tobytes() == np.concatenate([epoch.behaviours[0] for epoch in epochs]).tobytes()


def test_the_rows_of_epochs_sum_up_their_trials(results):
    rows, trials = of_seed_2(results.epochs()), of_seed_2(results.trials())
    by_epoch = trials.groupby("epoch")
    assert np.array_equal(rows["best"], by_epoch["performance"].max())
    assert rows["mean"].to_numpy() == pytest.approx(by_epoch["performance"].mean(), rel=1e-14)
    for name in ("ok", "limited", "refined", "diverged"):
        assert np.array_equal(rows[name], by_epoch["status"].agg(lambda status, name=name: (status == name).sum()))
    assert np.array_equal(rows["reused"], by_epoch["reused"].sum())
    assert (rows[["ok", "limited", "refined", "diverged"]].sum(axis=1) == 20).all()


def test_the_epochs_say_which_robot_tried(results):
    rows = of_seed_2(results.epochs())
    # 0.3 sin(2 pi n/5), from epoch 6 on the adult; the last 5 % of 6 epochs are none, so nothing decays.
    expected = [1 + 0.3 * np.sin(2 * np.pi * n / 5) if n < 6 else 1.0 for n in range(12)]
    assert rows["mass"].to_numpy() == pytest.approx(expected, abs=1e-15)
    assert (rows[["stiffness", "size", "gravity"]] == 1.0).all(axis=None)


def test_a_run_is_the_best_of_its_last_epoch_and_the_sums_of_its_epochs(results, epochs):
    (run,) = of_seed_2(results.runs()).to_dict("records")
    last = epochs[-1]
    assert run["performance"] == np.nanmax(last.performance)
    assert run["path_before"] == last.path_before[0]
    assert run["path_before"] + run["path_after"] == pytest.approx(last.path[0], rel=1e-15)
    assert (run["epochs"], run["trials"], run["status"]) == (12, 240, "ok")
    for name in ("diverged", "refined"):
        assert run[name] == sum((epoch.status == name).sum() for epoch in epochs) > 0
    assert run["reused"] == sum(epoch.reused.sum() for epoch in epochs)
    assert run["wobble.dimension"] == "mass"


def test_a_fixed_run_has_null_where_it_has_no_wobble(results):
    runs = results.runs("condition", "wobble.amplitude", "wobble.dimension")
    assert runs[runs["condition"] == "fixed"].drop(columns="condition").isna().all(axis=None)


def test_a_diverged_trial_is_a_row_with_status_and_time_and_no_score(results):
    trials = results.trials("status", "performance", "diverged_at")
    diverged = trials[trials["status"] == "diverged"]
    assert 0 < len(diverged) < len(trials)
    assert diverged["performance"].isna().all()
    assert (diverged["diverged_at"] == 1.25).all()
    assert trials[trials["status"] == "ok"]["performance"].notna().all()


def test_a_refined_trial_is_a_row_with_a_score_its_step_and_the_bound_it_left(results):
    trials = results.trials("status", "performance", "dt", "bound")
    refined = trials[trials["status"] == "refined"]
    assert 0 < len(refined) < len(trials)
    assert refined["performance"].notna().all()
    assert set(zip(trials["status"], trials["dt"], trials["bound"], strict=True)) == {
        ("ok", 0.01, ""),
        ("refined", 0.0025, "strain"),
        ("diverged", 0.00125, "energy"),
    }


@pytest.mark.parametrize(("log", "tables"), [("epochs", 2), ("trials", 3), ("behaviours", 4)])
def test_the_log_decides_which_tables_are_written(tmp_path, log, tables):
    sweep(study(f"log={log}", seeds="0"), tmp_path, simulate=toy)
    assert sum((tmp_path / name).is_dir() for name in ("runs", "epochs", "trials", "behaviours")) == tables


# --- failure -------------------------------------------------------------------------------------------------------


def all_diverge(_, behaviours, **__):
    return outcome(np.zeros(len(behaviours)), np.ones(len(behaviours), dtype=bool))


def test_a_run_in_which_everything_diverges_is_a_failed_row_without_a_score(tmp_path):
    found = sweep(study(), tmp_path, simulate=all_diverge)
    assert (found.done, found.failed) == (8, 8)
    runs = load(tmp_path).runs("status", "performance", "diverged", "trials")
    assert (runs["status"] == "failed").all()
    assert runs["performance"].isna().all()
    assert (runs["diverged"] == runs["trials"]).all()
    assert load(tmp_path).epochs("best", "mean").isna().all(axis=None)


def test_a_learner_that_raises_costs_its_own_runs_and_is_tried_again(tmp_path):
    def raises_when_light(body, behaviours, *, morphology, **settings):
        if morphology.mass < 0.9:
            raise FloatingPointError("too\nlight")
        return toy(body, behaviours, morphology=morphology, **settings)

    said = []
    found = sweep(study(), tmp_path, simulate=raises_when_light, progress=said.append)
    assert (found.done, found.failed, found.stopped) == (4, 4, False)
    failures = [told.message for told in said if told.kind == "failure"]
    assert failures == ["mass, seeds 0..3: failed in epoch 3: FloatingPointError: too light"]
    manifest = read_manifest(tmp_path)
    assert "raises_when_light" in manifest.failures["mass", 2]
    again = sweep(study(), tmp_path, simulate=toy)
    assert (again.present, again.done, again.failed) == (4, 4, 0)
    assert read_manifest(tmp_path).failures == {}


def test_one_diverging_robot_does_not_touch_the_others(tmp_path, results):
    alone = sweep(study(seeds="2"), tmp_path, simulate=toy)
    assert alone.done == 2
    mine, theirs = content(tmp_path), content(results.folder)
    assert mine.items() <= theirs.items()


# --- what it tells -------------------------------------------------------------------------------------------------


def test_progress_counts_up_to_all_runs_and_all_work(tmp_path):
    said = []
    sweep(study(), tmp_path, simulate=toy, progress=said.append)
    assert [told.kind for told in said].count("epoch") == 24
    assert [told.done for told in said if told.kind == "run"] == list(range(1, 9))
    fractions = [told.fraction for told in said]
    assert fractions == sorted(fractions)
    assert said[0].kind == "begin"
    assert said[0].fraction == 0.0
    assert said[-1].kind == "end"
    assert said[-1].fraction == pytest.approx(1.0)
    assert (said[-1].remaining, said[-1].diverged > 0) == (0.0, True)


def test_progress_of_a_resumed_sweep_starts_at_nothing_and_ends_at_all(tmp_path):
    sweep(study(), tmp_path, simulate=toy, stop=StopAfter(7))
    said = []
    sweep(study(), tmp_path, simulate=toy, progress=said.append)
    assert said[1].epoch == 8
    assert said[1].fraction < 0.1
    assert said[-1].fraction == pytest.approx(1.0)


def test_a_finished_sweep_has_nothing_to_do(tmp_path):
    sweep(study(), tmp_path, simulate=toy)
    found = sweep(study(), tmp_path, simulate=all_diverge)
    assert (found.wanted, found.present, found.done, found.failed) == (8, 8, 0, 0)
