"""A recording is the stored trial again: the same bits, frames at the right times, and a sentence where it is not."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from study.toy import study

import wobblesim as ws
from wobblesim.analysis.tables import load
from wobblesim.config import parse_config
from wobblesim.learning.search import ranking
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep
from wobblesim.viewing import recording
from wobblesim.viewing.recording import record

SMALL = ("learning.epochs=3", "trial.duration=1", "conditions.mass.wobble.end=2")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two conditions of a small robot, two seeds, every behaviour stored."""
    folder = tmp_path_factory.mktemp("robots")
    sweep(study(*SMALL, seeds="0..1"), folder)
    return load(folder)


def results_of(folder, *settings, seeds="0"):
    sweep(study(*SMALL, *settings, seeds=seeds), folder)
    return load(folder)


def test_the_full_size_robot_comes_to_the_stored_performance_bit_for_bit(tmp_path):
    config = "name: smoke\nlearning: {epochs: 3}\ntrial: {duration: 1}\nlog: epochs\n"
    sweep(parse_config(config), tmp_path)
    found = record(load(tmp_path), "smoke", 0)
    stored = load(tmp_path).runs("performance")["performance"][0]
    assert found.positions.shape == (26, 108, 2)
    assert found.performance == found.stored == stored
    assert found.is_the_stored_trial
    assert found.notes == []
    # The last frame holds float32 numbers up to 772, the performance is from the state itself: measured 8e-9.
    assert abs(found.distance[-1] - stored) < 1e-6


@pytest.mark.parametrize("epoch", [0, 1, 2])
@pytest.mark.parametrize("condition", ["fixed", "mass"])
def test_the_best_of_any_epoch_is_found_and_has_the_bits_of_its_row(results, condition, epoch):
    trials, behaviours = results.trials(), results.behaviours()
    is_mine = (trials["condition"] == condition) & (trials["seed"] == 1) & (trials["epoch"] == epoch)
    best = ranking(trials[is_mine]["performance"].to_numpy())[0]
    found = record(results, condition, 1, epoch)
    assert found.performance == trials[is_mine]["performance"].to_numpy()[best]
    assert np.array_equal(found.behaviour, behaviours[is_mine]["genotype"].to_numpy()[best])
    assert found.is_the_stored_trial


def test_the_robot_is_that_of_the_epoch(results):
    factor = results.epochs("condition", "seed", "epoch", "mass").query("condition == 'mass' and epoch == 1")["mass"]
    assert record(results, "mass", 0, 1).morphology == ws.Morphology(mass=float(factor.iloc[0]))
    assert record(results, "mass", 0).morphology == ws.Morphology()
    heavy = record(results, "mass", 0, 1).body.mass / record(results, "fixed", 0, 1).body.mass
    assert heavy == pytest.approx(float(factor.iloc[0]), rel=1e-15)  # measured 2e-16


def test_the_last_epoch_is_found_with_or_without_the_table_of_behaviours(results):
    last, named = record(results, "fixed", 0), record(results, "fixed", 0, 2)
    assert last.epoch == named.epoch == 2
    assert np.array_equal(last.behaviour, named.behaviour)
    assert np.array_equal(last.positions, named.positions)


@pytest.mark.parametrize(
    ("fps", "interval", "frames"), [(30, 0.04, 26), (50, 0.02, 51), (1000, 0.02, 51), (17, 0.06, 18), (0.1, 1.0, 2)]
)
def test_frames_are_the_nearest_whole_number_of_steps_apart_and_the_last_is_the_end(results, fps, interval, frames):
    found = record(results, "fixed", 0, frames_per_second=fps)
    assert len(found.times) == len(found.positions) == frames
    np.testing.assert_allclose(found.times[:-1], interval * np.arange(frames - 1), rtol=0, atol=1e-15)
    assert found.times[-1] == 1.0
    every = record(results, "fixed", 0, frames_per_second=50)
    at = np.rint(found.times / 0.02).astype(int)
    assert np.array_equal(found.positions, every.positions[at])


def test_a_part_of_a_trial_is_the_beginning_of_the_whole_and_is_said_to_be(results):
    whole, part = record(results, "mass", 0), record(results, "mass", 0, seconds=0.4)
    assert part.times[-1] == 0.4
    assert np.array_equal(part.positions, whole.positions[: len(part.times)])
    assert part.performance == whole.performance
    assert part.notes == ["The first 0.4 s of a trial of 1 s."]


def test_a_refined_trial_is_shown_as_it_was_refined_at_the_same_times(tmp_path):
    results = results_of(tmp_path, "physics.dt=0.04", "physics.max_speed=150")
    trials = results.trials()
    row = trials.index[trials["status"] == "refined"][0]  # there are 13 such in two epochs
    tried = recording._Tried(int(trials["epoch"][row]), results.behaviours()["genotype"][row], 0.0)
    setup = recording._run_of(results, str(trials["condition"][row]), 0).setup
    whole, part = (recording._watch(setup, tried, 25.0, seconds) for seconds in (60.0, 0.4))
    assert whole.trial.status[0] == part.trial.status[0] == "refined"
    assert whole.trial.displacement[0] == trials["performance"][row]
    assert whole.trial.dt[0] == trials["dt"][row] < 0.04
    assert np.array_equal(whole.times, 0.04 * np.arange(26))
    # Frames of the run with the smaller step, one in each 0.04 s; also of the part that the larger step could do.
    finer = ws.simulate(
        setup.body, [tried.behaviour], morphology=setup.morphology(tried.epoch), scene=setup.scene, gait=setup.gait,
        physics=replace(setup.physics, dt=float(whole.trial.dt[0])), duration=1.0, record_every=1,
    )  # fmt: skip
    every = round(0.04 / whole.trial.dt[0])
    assert np.array_equal(whole.positions, finer.positions[::every, :, :, 0])
    assert np.array_equal(part.positions, whole.positions[:11])


def test_a_refined_trial_says_so(results):
    found = replace(record(results, "fixed", 0), status="refined", bound="speed", dt=0.005)
    assert found.notes == [
        "It left the trusted bounds (speed) at first: this is the run with a step of 0.005 s.",
    ]


def test_a_diverged_trial_ends_where_it_was_lost_and_says_so(tmp_path):
    results = results_of(tmp_path, "physics.max_speed=0.001", "physics.refinements=0")
    assert results.runs("status")["status"].tolist() == ["failed", "failed"]
    with pytest.raises(StoreError, match=r"has no score, because all trials of its last epoch diverged; .* --epoch 2$"):
        record(results, "fixed", 0)
    found = record(results, "fixed", 0, 2)
    assert math.isnan(found.performance)
    assert found.is_the_stored_trial  # neither has a score
    assert np.isfinite(found.positions).all()
    assert found.times[-1] < found.diverged_at == 0.64  # 32 steps: the first look
    assert found.notes == [
        "This trial diverged: it left the trusted bounds (speed) and was stopped at 0.64 s. "
        "The recording ends at 0.6 s."
    ]


def test_frames_out_of_all_bounds_are_not_shown():
    body = ws.starfish(arms=3, sections=2)
    positions = np.zeros((4, body.n_nodes, 2))
    positions[2, 5, 1] = 1e9
    times, kept = recording._until_lost(body, np.arange(4.0), positions)
    assert (times.tolist(), len(kept)) == ([0.0, 1.0], 2)
    positions[0, 0, 0] = np.nan
    assert len(recording._until_lost(body, np.arange(4.0), positions)[1]) == 1


def test_by_how_much_another_performance_differs_is_said(results):
    found = replace(record(results, "fixed", 0), performance=0.5, stored=0.25)
    assert not found.is_the_stored_trial
    assert found.notes == [
        "This is not quite the stored trial, which another version or processor has computed: it comes to "
        "0.5 body lengths, stored is 0.25 body lengths, a difference of 0.25."
    ]
    lost = replace(found, stored=math.nan)
    assert lost.notes[0].endswith("it comes to 0.5 body lengths, stored is no score (diverged).")


def test_contraction_is_the_part_by_which_a_muscle_is_shorter_than_at_rest(results):
    found = record(results, "fixed", 0)
    assert found.contraction.shape == (len(found.times), len(found.body.muscle_spring))
    # At the start all springs are as built; float32 places: measured 3e-8.
    assert np.abs(found.contraction[0]).max() < 1e-6
    a, b = found.body.springs[found.body.muscle_spring[3]]
    length = math.dist(found.positions[7, a], found.positions[7, b])
    rest = found.body.rest_length[found.body.muscle_spring[3]]
    assert found.contraction[7, 3] == pytest.approx((rest - length) / rest, abs=1e-15)  # measured 1e-16


@pytest.mark.parametrize(
    ("condition", "seed", "epoch", "said"),
    [
        ("mas", 0, None, r"has no condition 'mas' \(did you mean 'mass'\?\); choose among fixed, mass$"),
        ("zebra", 0, None, r"has no condition 'zebra'; choose among fixed, mass$"),
        ("fixed", 7, None, r"has no seed 7 of fixed; choose among seeds 0\.\.1$"),
        ("fixed", 0, 3, r"fixed, seed 0 of .* has no epoch 3; choose one from 0 to 2$"),
        ("fixed", 0, -1, r"has no epoch -1; choose one from 0 to 2$"),
    ],
)
def test_what_is_not_there_is_said_in_a_sentence_with_a_remedy(results, condition, seed, epoch, said):
    with pytest.raises(StoreError, match=said):
        record(results, condition, seed, epoch)


def test_epochs_whose_behaviours_were_not_stored_are_said_to_be_so(tmp_path):
    results = results_of(tmp_path, "log=trials")
    assert record(results, "mass", 0).is_the_stored_trial
    with pytest.raises(StoreError, match=r"were not stored, but for the last epoch's best; set `log: behaviours`"):
        record(results, "mass", 0, 1)


def test_results_of_a_version_without_the_last_behaviour_need_the_table_of_all(results, tmp_path, monkeypatch):
    read = recording.read_run

    def read_old(path, seed):
        run = read(path, seed)
        return replace(run, rows=run.rows.drop_columns(["genotype"])) if run.table == "runs" else run

    wanted, shorter = record(results, "mass", 1), results_of(tmp_path, "log=epochs")
    monkeypatch.setattr(recording, "read_run", read_old)
    found = record(results, "mass", 1)
    assert np.array_equal(found.behaviour, wanted.behaviour)
    assert found.performance == wanted.performance
    with pytest.raises(StoreError, match=r"mass, seed 0 were not stored, by an older version; set `log: behaviours`"):
        record(shorter, "mass", 0)


def test_a_run_that_came_to_no_result_is_said_to_be_so(results):
    key = "mass", 5
    results.manifest.failures[key] = "Traceback ...\nMemoryError: too much\n"
    with pytest.raises(
        StoreError, match=r"mass, seed 5 of .* came to no result \(MemoryError: too much\); give the sweep"
    ):
        record(results, *key)
    del results.manifest.failures[key]


def test_an_altered_file_is_refused(results, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(results.folder, folder)
    file = folder / "runs" / "condition=fixed" / "seed-0.parquet"
    pq.write_table(pq.ParquetFile(file).read(), file)
    with pytest.raises(StoreError, match="verify"):
        record(load(folder), "fixed", 0)


@pytest.mark.parametrize("wrong", [{"frames_per_second": 0.0}, {"seconds": -1.0}, {"seconds": math.inf}])
def test_rates_and_times_are_above_0(results, wrong):
    with pytest.raises(ValueError, match="must be finite and above 0"):
        record(results, "fixed", 0, **wrong)


def test_a_robot_of_many_nodes_has_fewer_frames(results, monkeypatch):
    monkeypatch.setattr(recording, "MOST_NUMBERS", 2 * 21 * 10)
    found = record(results, "fixed", 0)
    assert found.positions.size <= 2 * 21 * 12
    assert found.times[-1] == 1.0
