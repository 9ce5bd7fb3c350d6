"""What `sweep --dry-run` foretells, against what a sweep does."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from study.toy import StopAfter, toy
from study.toy import study as toy_study

from wobblesim.commands import main
from wobblesim.config import columns
from wobblesim.numerics import probe
from wobblesim.numerics.probe import Speed, forecast
from wobblesim.study.execute import sweep
from wobblesim.study.lock import Shard
from wobblesim.study.plan import lane_steps
from wobblesim.study.preview import preview
from wobblesim.study.store import StoreError
from wobblesim.study.work import Interval


def totals(seen):
    return {name: sum(row[name] for row in seen.rows()) for name in ("wanted", "present", "missing", "lane_steps")}


def everything(folder: Path):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


# --- counting ------------------------------------------------------------------------------------------------------


def test_nothing_is_there_and_nothing_is_made(tmp_path):
    seen = preview(toy_study(), tmp_path / "none")
    assert [row["condition"] for row in seen.rows()] == ["fixed", "mass"]
    # 12 epochs; all 20 behaviours in epoch 0, and up to the end of the wobble, in epoch 6; else the 15 new ones
    steps = 3000
    assert [row["lane_steps"] for row in seen.rows()] == [
        4 * (20 + 11 * 15) * steps,
        4 * (7 * 20 + 5 * 15) * steps,
    ]
    assert totals(seen) | {"lane_steps": 0} == {"wanted": 8, "present": 0, "missing": 8, "lane_steps": 0}
    assert not (tmp_path / "none").exists()


def test_what_is_present_is_not_done_again(tmp_path):
    sweep(toy_study(seeds="0,2"), tmp_path, simulate=toy)
    before = everything(tmp_path)
    seen = preview(toy_study(seeds="0..4"), tmp_path)
    assert totals(seen) | {"lane_steps": 0} == {"wanted": 10, "present": 4, "missing": 6, "lane_steps": 0}
    assert {seed for group in seen.plan for seed in group.seeds} == {1, 3, 4}
    assert totals(preview(toy_study(seeds="2"), tmp_path))["lane_steps"] == 0
    assert everything(tmp_path) == before


def test_a_group_in_work_has_only_its_last_epochs_left(tmp_path):
    config = toy_study()
    sweep(config, tmp_path, simulate=toy, threads=1, stop=StopAfter(5), checkpoint=Interval(epochs=1))
    before = everything(tmp_path)
    seen = preview(config, tmp_path)
    ((group, epoch),) = seen.epochs.items()
    assert 0 < epoch < 12
    setup = seen.study.setups[group.condition]
    row = next(row for row in seen.rows() if row["condition"] == group.condition)
    rest = (4 - len(group.seeds)) * lane_steps(setup)
    assert row["lane_steps"] == len(group.seeds) * lane_steps(setup, epoch) + rest
    assert row["missing"] == 4
    assert everything(tmp_path) == before


def test_shards_foresee_parts_of_the_whole(tmp_path):
    config = toy_study(seeds="0..9")
    whole = totals(preview(config, tmp_path))
    parts = [totals(preview(config, tmp_path, Shard(number, 3))) for number in (1, 2, 3)]
    assert {name: sum(part[name] for part in parts) for name in whole} == whole
    assert all(part["missing"] for part in parts)


def test_a_folder_that_a_sweep_would_refuse_is_refused(tmp_path):
    sweep(toy_study(), tmp_path, simulate=toy)
    with pytest.raises(StoreError, match=r"learning\.rate"):
        preview(toy_study("learning.rate=0.2"), tmp_path)


# --- time, disk and memory -----------------------------------------------------------------------------------------


def stored(seen):
    return lambda name: columns(seen.study.conditions[name])


@pytest.fixture
def no_kernels(monkeypatch):
    """Steps and calls of known time instead of timed ones; counts how many were asked for."""
    asked = []

    def known(setup, seeds, workers, threads, patience):
        asked.append(setup.physics)
        return Speed(call=0.01, step=1e-3 * setup.physics.dt)

    monkeypatch.setattr(probe, "speed", known)
    return asked


def test_with_known_times_the_forecast_is_a_sum_over_epochs(tmp_path, no_kernels, monkeypatch):
    books = probe.Books(epoch=0.5, commit=0.25, run=1000, per_epoch=10, logged=80)
    monkeypatch.setattr(probe, "keep_books", lambda *_: books)
    config = toy_study("conditions={fixed: {wobble: null}}", seeds="0..3")
    seen = preview(config, tmp_path)
    assert [len(group.seeds) for group in seen.plan] == [4]
    found = forecast(seen, stored(seen))
    # 80 trials in 5 blocks of 16 lanes in epoch 0, then 60 in 4
    whole, rest = 0.01 + 3000 * 5 * 2e-5, 0.01 + 3000 * 4 * 2e-5
    assert abs(found.seconds - (whole + 11 * rest + 12 * 0.5 + 4 * 0.25)) < 1e-9
    assert found.core_seconds == {"fixed": pytest.approx(found.seconds)}
    assert found.results == 4 * (1000 + 12 * 10)
    assert found.checkpoints == 4 * 12 * 80
    assert 50e6 < found.memory < 4e9


def test_as_many_workers_as_groups_take_as_long_as_the_longest(tmp_path, no_kernels):
    config = toy_study(seeds="0..11")
    alone, together = (preview(config, tmp_path, None, workers) for workers in (1, 2))
    one, two = forecast(alone, stored(alone), 1), forecast(together, stored(together), 2)
    assert sum(one.core_seconds.values()) / 2 <= two.seconds <= one.seconds
    assert two.memory > one.memory


def test_few_of_many_kinds_are_timed_and_each_integrator_is(tmp_path, no_kernels):
    config = toy_study(
        "conditions={}",
        "wobble={dimension: mass, amplitude: 0.1, period: 5}",
        "sweep={physics.dt: [0.01, 0.005, 0.004, 0.002], physics.precision: [float32, float64], "
        "physics.integrator: [midpoint, impulse]}",
    )
    seen = preview(config, tmp_path)
    found = forecast(seen, stored(seen))
    assert (found.kinds, found.timed) == (16, probe.MOST_KERNELS)
    assert len({(physics.integrator, physics.precision) for physics in no_kernels}) == 4
    assert set(found.core_seconds) == set(seen.study.conditions)
    # those with the smallest step have most to do, and are timed before others of their integrator
    assert sum(physics.dt == 0.002 for physics in no_kernels) == 4


def test_nothing_to_do_needs_nothing(tmp_path):
    sweep(toy_study(), tmp_path, simulate=toy)
    seen = preview(toy_study(), tmp_path)
    found = forecast(seen, stored(seen))
    assert (found.seconds, found.results, found.checkpoints, found.core_seconds) == (0, 0, 0, {})


def test_the_disk_foreseen_is_that_of_the_sweep(tmp_path, no_kernels):
    config = toy_study("learning.epochs=300", "log=trials", "conditions.mass.log=epochs")
    seen = preview(config, tmp_path)
    foreseen = forecast(seen, stored(seen)).results
    sweep(config, tmp_path, simulate=toy)
    found = sum(path.stat().st_size for path in tmp_path.rglob("*.parquet"))
    assert 0.8 < foreseen / found < 1.25  # measured 0.93


def test_a_call_that_only_takes_its_time_is_timed(monkeypatch):
    # as if a call took 2 ms and 20 µs a step, whatever it is asked for
    setup = preview(toy_study(), Path("none")).study.setups["fixed"]

    monkeypatch.setattr(probe, "_call", lambda _, n_trials, threads, n_steps, changed=1.0: 0.002 + 20e-6 * n_steps)
    found = probe.speed(setup, seeds=4, workers=1, threads=1, patience=0.1)
    assert abs(found.step * 5 - 20e-6) < 1e-12  # 80 trials are five blocks
    assert abs(found.call - 0.002) < 1e-9
    assert abs(found.group(setup, 4, 1) - (12 * 0.002 + 3000 * 20e-6 * (1 + 11 * 4 / 5))) < 1e-6


@pytest.mark.nightly  # compiles kernels, and is a matter of how busy the machine is
@pytest.mark.parametrize("changes", [(), ("physics.precision=float64",), ("trial.duration=4", "log=behaviours")])
def test_the_time_foreseen_is_that_of_the_sweep(tmp_path, changes):
    config = toy_study("robot={kind: starfish}", "learning.epochs=40", "trial.duration=20", *changes)
    seen = preview(config, tmp_path)
    forecast(seen, stored(seen))  # compiles
    foreseen = [forecast(seen, stored(seen)).seconds]
    taken = sweep(config, tmp_path, threads=1).seconds
    foreseen.append(forecast(seen, stored(seen)).seconds)
    assert 0.5 < taken / (sum(foreseen) / 2) < 2.0  # measured 0.65 to 1.8 in 18 sweeps, with the median 1.03


# --- as it is printed ----------------------------------------------------------------------------------------------

GRID = """
name: grid
robot: {kind: starfish, arms: 3, sections: 2}
trial: {duration: 1}
learning: {epochs: 2}
wobble: {dimension: mass, amplitude: 0.1, period: 5}
sweep:
  wobble.period: [%s]
"""


def dry_run(folder: Path, conditions: int, *options: str):
    folder.mkdir(exist_ok=True)
    path = folder / "grid.yaml"
    path.write_text(GRID % ", ".join(map(str, range(3, 3 + conditions))))
    out = str(folder / "out")
    found = CliRunner().invoke(main, ["sweep", str(path), "--dry-run", "--out", out, *options], catch_exceptions=False)
    assert found.exit_code == 0, found.output
    assert not (folder / "out").exists()
    return found.stdout


def test_a_terminal_sees_a_few_conditions_of_many_and_json_has_all(tmp_path, no_kernels):
    few, many = dry_run(tmp_path, 20), dry_run(tmp_path, 300)
    assert all(f"period-{period} " in few for period in range(3, 23))
    assert len(many.splitlines()) < 35
    assert "and 288 others" in many
    data = json.loads(dry_run(tmp_path, 300, "--json", "--seeds", "0..4"))
    assert len(data["conditions"]) == 300
    assert data["missing"] == sum(row["missing"] for row in data["conditions"]) == 1500
    assert data["core_hours"] == pytest.approx(sum(row["core_hours"] for row in data["conditions"]))
    assert data["core_hours"] == pytest.approx(data["seconds"] * data["threads"] / 3600)
    assert data["disk"]["results"] > 1500 * 10_000


def test_a_shard_sees_its_part(tmp_path, no_kernels):
    whole = json.loads(dry_run(tmp_path, 6, "--json", "--seeds", "0..9"))
    parts = [json.loads(dry_run(tmp_path, 6, "--json", "--seeds", "0..9", "--shard", f"{n}/2")) for n in (1, 2)]
    assert sum(part["missing"] for part in parts) == whole["missing"] == 60
    assert parts[0]["shard"] == "1/2"
    assert "shard 1/2" in dry_run(tmp_path, 6, "--shard", "1/2")
