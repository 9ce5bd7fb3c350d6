"""Lineages agree with a walk in plain Python, and their paths with what the learner counted while it searched."""

import math

import numpy as np
import pandas as pd
import pytest
from study.toy import outcome, study, toy

from wobblesim.analysis.lineage import OF_BEHAVIOURS, OF_TRIALS, best_slots
from wobblesim.analysis.tables import load
from wobblesim.learning.search import ranking
from wobblesim.study.compact import compact
from wobblesim.study.execute import sweep
from wobblesim.study.store import StoreError

EPOCHS, SLOTS = 12, 20


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toy")
    sweep(study(), folder, simulate=toy)
    return folder


@pytest.fixture(scope="module")
def results(folder):
    return load(folder)


class Twin:
    """One run, looked up by (epoch, slot) in dictionaries."""

    def __init__(self, results, condition, seed):
        rows = results.trials().merge(results.behaviours(), on=["condition", "seed", "epoch", "slot"])
        rows = rows[(rows["condition"] == condition) & (rows["seed"] == seed)]
        self.rows = {(row.epoch, row.slot): row for row in rows.itertuples()}
        self.last = max(epoch for epoch, _ in self.rows)

    def best(self, epoch):
        scores = {slot: row.performance for (number, slot), row in self.rows.items() if number == epoch}
        return max(scores, key=lambda slot: (-math.inf if math.isnan(scores[slot]) else scores[slot], -slot))

    def ancestry(self, epoch, slot):
        """Places from the behaviour back to epoch 0."""
        places = [(epoch, slot)]
        while places[-1][0] > 0:
            row = self.rows[places[-1]]
            places.append((row.epoch - 1, row.parent))
        return places

    def modification(self, place):
        epoch, parent = place[0], self.rows[place].parent
        return math.dist(self.rows[place].genotype, self.rows[epoch - 1, parent].genotype) if epoch else 0.0

    def path(self, place):
        return sum(map(self.modification, self.ancestry(*place)))

    def family(self):
        return sorted({place for epoch in range(self.last + 1) for place in self.ancestry(epoch, self.best(epoch))})


RUNS = [("fixed", 0), ("mass", 3)]


@pytest.mark.parametrize(("condition", "seed"), RUNS)
def test_a_lineage_is_the_best_of_each_epoch_and_all_their_ancestors(results, condition, seed):
    twin, found = Twin(results, condition, seed), results.lineage(condition=condition, seed=seed)
    places = list(zip(found["epoch"], found["slot"], strict=True))
    final = set(twin.ancestry(twin.last, twin.best(twin.last)))
    assert places == twin.family()
    assert found["best"].tolist() == [slot == twin.best(epoch) for epoch, slot in places]
    assert found["final"].tolist() == [place in final for place in places]
    for name in ("parent", "performance", "status"):
        expected = [getattr(twin.rows[place], name) for place in places]
        assert np.array_equal(found[name], expected, equal_nan=name == "performance")
    assert all(
        np.array_equal(mine, twin.rows[place].genotype) for mine, place in zip(found.genotype, places, strict=True)
    )
    # math.dist is correctly rounded, the sum of squares is not; measured 7e-18
    assert found["modification"].to_numpy() == pytest.approx([twin.modification(place) for place in places], abs=1e-15)
    # measured 6e-17
    assert found["path"].to_numpy() == pytest.approx([twin.path(place) for place in places], abs=1e-15)


@pytest.mark.parametrize(
    ("condition", "seed", "epoch", "slot"), [("fixed", 1, 11, 19), ("mass", 2, 7, 0), ("mass", 0, 0, 4)]
)
def test_the_ancestry_of_any_behaviour_has_one_row_an_epoch(results, condition, seed, epoch, slot):
    twin, found = Twin(results, condition, seed), results.ancestors(condition, seed, epoch, slot)
    assert list(zip(found["epoch"], found["slot"], strict=True)) == twin.ancestry(epoch, slot)[::-1]
    assert found["path"].iloc[-1] == pytest.approx(twin.path((epoch, slot)), abs=1e-15)  # measured 6e-17
    assert (found["condition"] == condition).all()
    assert list(found.columns) == [*OF_TRIALS, *OF_BEHAVIOURS]


def test_without_a_place_the_ancestry_is_that_of_the_best_of_the_last_epoch_or_of_the_given_one(results):
    whole = results.lineage(condition="mass", seed=1)
    pd.testing.assert_frame_equal(results.ancestors("mass", 1), whole[whole["final"]].reset_index(drop=True))
    best = results.ancestors("mass", 1, epoch=5).iloc[-1]
    assert (best["epoch"], best["best"]) == (5, True)


def test_paths_are_the_bits_that_the_learner_has_stored(results):
    family, epochs = results.lineage(), results.epochs("condition", "seed", "epoch", "best", "path")
    best = family[family["best"]].reset_index(drop=True)
    for name, stored in (("condition", "condition"), ("epoch", "epoch"), ("performance", "best"), ("path", "path")):
        assert np.array_equal(best[name], epochs[stored])


def test_the_path_of_the_final_ancestry_is_that_of_the_run_before_and_after_the_wobble(results):
    runs = results.runs("condition", "seed", "path_before", "path_after")
    for condition, seed, before, after in runs.itertuples(index=False):
        path = results.ancestors(condition, seed)["path"].to_numpy()
        assert (path[6], path[-1] - path[6]) == (before, after)  # the wobble ends in epoch 6, half of the 12


def test_the_best_slot_is_the_first_of_the_ranking_also_with_ties_and_without_numbers():
    rng = np.random.default_rng(5)
    performance = rng.integers(0, 3, (500, 5)).astype(float)
    performance[rng.random(performance.shape) < 0.4] = np.nan
    assert np.isnan(performance).all(axis=1).any()
    assert best_slots(performance).tolist() == [ranking(row)[0] for row in performance]


def test_a_run_in_which_every_trial_diverged_has_a_lineage(tmp_path):
    def fails(body, behaviours, **_):
        return outcome(np.zeros(len(behaviours)), diverged=np.ones(len(behaviours), dtype=bool))

    sweep(study("learning.epochs=3", "conditions.mass.wobble.end=2", seeds="0"), tmp_path, simulate=fails)
    found = load(tmp_path).ancestors("mass", 0)
    assert found["slot"].tolist() == [0, 0, 0]
    assert found["performance"].isna().all()
    assert found["path"].tolist() == [0.0, 0.0, 0.0]


# --- what is read --------------------------------------------------------------------------------------------------


def test_columns_come_as_asked_for_and_conditions_stay_in_the_order_of_the_study(results):
    found = results.lineage("path", "condition", "epoch")
    assert list(found.columns) == ["path", "condition", "epoch"]
    assert found["condition"].cat.categories.tolist() == ["fixed", "mass"]
    assert found["condition"].cat.ordered


def test_files_that_are_not_needed_stay_closed(tmp_path):
    sweep(study(seeds="0..1"), tmp_path, simulate=toy)
    results = load(tmp_path)
    whole = results.lineage()
    for table in ("trials", "behaviours"):
        (tmp_path / table / "condition=mass" / "seed-0.parquet").unlink()
    mine = whole[(whole["condition"] == "mass") & (whole["seed"] == 1)].reset_index(drop=True)
    pd.testing.assert_frame_equal(results.lineage(condition="mass", seed=1), mine)
    for file in (tmp_path / "behaviours").rglob("*.parquet"):
        file.unlink()
    columns = ["epoch", "slot", "final"]
    pd.testing.assert_frame_equal(results.lineage(*columns, condition="mass", seed=1), mine[columns])
    with pytest.raises(StoreError, match="missing or damaged"):
        results.lineage("path", condition="mass", seed=1)


def test_after_compacting_and_adding_seeds_between_the_lineage_is_the_same(tmp_path, results):
    sweep(study(seeds="0,3"), tmp_path, simulate=toy)
    compact(tmp_path)
    sweep(study(), tmp_path, simulate=toy)
    mixed = load(tmp_path)
    pd.testing.assert_frame_equal(mixed.lineage(), results.lineage())
    pd.testing.assert_frame_equal(mixed.ancestors("mass", 3), results.ancestors("mass", 3))
    pd.testing.assert_frame_equal(mixed.lineage(seed=1), results.lineage(seed=1))


def test_robots_of_different_sizes_have_genotypes_of_their_own_lengths(tmp_path):
    sweep(study("conditions.big={robot: {arms: 4}, wobble: null}", seeds="0"), tmp_path, simulate=toy)
    found = load(tmp_path).lineage("condition", "genotype")
    lengths = found["genotype"].map(len).groupby(found["condition"], observed=True).unique()
    assert {name: lengths[name].tolist() for name in ("fixed", "big")} == {"fixed": [12], "big": [16]}


def test_without_behaviours_there_is_a_lineage_without_genotypes_and_without_trials_none(tmp_path):
    sweep(study("log=trials", seeds="0"), tmp_path / "trials", simulate=toy)
    sweep(study("log=epochs", seeds="0"), tmp_path / "epochs", simulate=toy)
    trials, epochs = load(tmp_path / "trials"), load(tmp_path / "epochs")
    assert list(trials.lineage().columns) == list(OF_TRIALS)
    assert list(trials.ancestors("mass", 0).columns) == list(OF_TRIALS)
    with pytest.raises(StoreError, match="has no behaviours; set `log: behaviours`"):
        trials.lineage("path")
    for refused in (epochs.lineage, lambda: epochs.ancestors("mass", 0)):
        with pytest.raises(StoreError, match="has no trials; set `log: trials`"):
            refused()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda results: results.ancestors("mas", 0), r"has no condition 'mas'; did you mean mass\?"),
        (lambda results: results.ancestors("zebra", 0), "has no condition 'zebra'; it has fixed, mass$"),
        (lambda results: results.ancestors("mass", 9), "has no run of mass with seed 9; the nearest is 3"),
        (lambda results: results.lineage(condition="mass", seed=-1), "with seed -1; the nearest is 0"),
        (lambda results: results.lineage(seed=9), "has no run with seed 9; the nearest is 3"),
        (lambda results: results.ancestors("mass", 1, 12), "mass with seed 1 has no epoch 12; give one of 0 to 11"),
        (lambda results: results.ancestors("mass", 1, 3, 20), "mass with seed 1 has no slot 20; give one of 0 to 19"),
        (lambda results: results.lineage("pth"), "a lineage of .* has no column 'pth'; nearest: path"),
    ],
)
def test_what_is_not_there_is_named_with_the_nearest_that_is(results, call, told):
    with pytest.raises(StoreError, match=told):
        call(results)
