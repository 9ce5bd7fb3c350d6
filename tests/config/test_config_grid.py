"""From a study to its conditions: products, names, ids, columns."""

from __future__ import annotations

import dataclasses
import gc
import itertools
import math
import re
import weakref
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from config.apart import Timed, quickest, read_apart
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import dataset
from pydantic import ValidationError

from wobblesim.config import (
    ConfigError,
    Parameters,
    SweepConfig,
    columns,
    condition_error,
    expand,
    parse_config,
    remarks,
)
from wobblesim.config.overrides import put
from wobblesim.config.schema import stored_bytes

BASE = "name: study\nwobble: {dimension: mass, amplitude: 0.1, period: 25}\n"


def ids(text: str) -> list[str]:
    return [condition.id for condition in expand(parse_config(text))]


def test_a_study_without_a_grid_is_one_condition_of_its_name() -> None:
    config = parse_config(BASE)
    (condition,) = expand(config)
    assert condition.id == "study"
    assert condition.parameters == config.parameters
    assert type(condition.parameters) is Parameters
    assert config.count_conditions() == 1


def test_the_product_comes_in_the_order_written_and_the_names_after_it() -> None:
    text = BASE + (
        "sweep:\n  wobble.dimension: [mass, [mass, size]]\n  wobble.amplitude: [0.10, 0.5]\n"
        "conditions:\n  fixed: {wobble: null}\n"
    )
    assert ids(text) == [
        "dimension-mass_amplitude-0.1",
        "dimension-mass_amplitude-0.5",
        "dimension-mass-size_amplitude-0.1",
        "dimension-mass-size_amplitude-0.5",
        "fixed",
    ]
    conditions = expand(parse_config(text))
    assert conditions[3].parameters.wobble is not None
    assert conditions[3].parameters.wobble.dimension == ("mass", "size")
    assert conditions[3].parameters.wobble.amplitude == 0.5
    assert conditions[3].parameters.wobble.period == 25
    assert conditions[4].parameters.wobble is None


def test_ids_stay_when_values_and_conditions_are_added() -> None:
    few = BASE + "sweep: {wobble.period: [25, 50]}\nconditions: {fixed: {wobble: null}}\n"
    many = BASE + "sweep: {wobble.period: [10, 25, 1e2, 50]}\nconditions: {a: {log: trials}, fixed: {wobble: null}}\n"
    assert set(ids(few)) < set(ids(many))
    by_id = {condition.id: condition.parameters for condition in expand(parse_config(many))}
    assert all(by_id[c.id] == c.parameters for c in expand(parse_config(few)))


@pytest.mark.parametrize(
    ("sweep", "first"),
    [
        ("{wobble.period: [25.0]}", "period-25"),
        ("{physics.dt: [1e-5]}", "dt-1e-05"),
        ("{physics.max_speed: [1e6]}", "max_speed-1000000"),
        ("{wobble.period: [25], trial.period: [0.5]}", "wobble.period-25_trial.period-0.5"),
        ("{scene.floor: [null]}", "floor-none"),
        ("{scene.gravity: [[0, -9.81]]}", "gravity-0--9.81"),
        ("{physics.integrator: [impulse]}", "integrator-impulse"),
        ("{wobble: [null]}", "wobble-none"),
    ],
)
def test_ids_are_readable(sweep: str, first: str) -> None:
    assert ids(f"{BASE}sweep: {sweep}\n") == [first]


def test_long_ids_are_cut_and_stay_different_and_safe() -> None:
    keys = ["restitution", "restitution_threshold", "stiffness"]
    swept = ", ".join(f"scene.floor.{key}: [0.1234567, 0.7654321]" for key in keys)
    found = ids(f"{BASE}sweep: {{{swept}, robot.stiffness.side: [3000, 4000]}}\n")
    assert len(set(found)) == 16
    assert all(re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}", one) for one in found)
    assert found == ids(f"{BASE}sweep: {{{swept}, robot.stiffness.side: [3000, 4000]}}\n")


def test_a_condition_changes_only_what_it_says() -> None:
    text = BASE + "conditions:\n  slow: {wobble: {period: 100}, scene: {floor: {restitution: 0}}}\n"
    (slow,) = expand(parse_config(text))
    base = parse_config(BASE).parameters
    assert slow.parameters.wobble == base.wobble.model_copy(update={"period": 100.0})  # type: ignore[union-attr]
    assert slow.parameters.scene.floor.stiffness == 10_000  # type: ignore[union-attr]
    assert slow.parameters.physics == base.physics


def test_a_condition_may_have_another_robot() -> None:
    robot = (
        "{kind: custom, nodes: [{position: [0, 0]}, {position: [9, 0]}], springs: [{between: [0, 1], stiffness: 10}],"
        " muscles: [{spring: 0, group: 0}]}"
    )
    two = parse_config(f"name: a\nconditions:\n  star:\n  stick: {{robot: {robot}}}\n")
    assert [condition.parameters.robot.kind for condition in expand(two)] == ["starfish", "custom"]
    swept = parse_config(f"name: a\nrobot: {robot}\nsweep: {{'robot.springs[0].stiffness': [10, 20]}}\n")
    assert [c.parameters.robot.springs[0].stiffness for c in expand(swept)] == [10, 20]  # type: ignore[union-attr]


def test_a_sweep_may_make_the_wobble() -> None:
    text = "name: a\nsweep: {wobble.dimension: [mass], wobble.amplitude: [0.1, 0.2], wobble.period: [25]}\n"
    assert len(ids(text)) == 2


@pytest.mark.parametrize(
    ("grid", "place", "key", "words"),
    [
        ("sweep: {wobble.perod: [5]}", (3, 9), "sweep.wobble.perod", "did you mean 'period'?"),
        ("sweep: {period: [5]}", (3, 9), "sweep.period", "period belongs under trial or wobble"),
        ("sweep: {seeds: [5]}", (3, 9), "sweep.seeds", "belongs at the top level"),
        ("sweep: {wobble.period: [5, x]}", (3, 28), "sweep.wobble.period[1]", "'x' is not a number"),
        ("sweep: {wobble.period: 5}", (3, 24), "sweep.wobble.period", "a list of values"),
        ("sweep: {wobble.period: []}", (3, 24), "sweep.wobble.period", "at least one"),
        ("sweep: {wobble.period: [5, 5.0]}", (3, 28), "sweep.wobble.period[1]", "listed twice"),
        ("sweep: {wobble: [{period: 5}]}", (3, 18), "sweep.wobble[0]", "under conditions"),
        ("sweep: {wobble: [null], wobble.period: [5]}", (3, 40), "sweep.wobble.period", "lies inside wobble"),
        ("sweep: {wobble: {period: [5]}}", (3, 17), "sweep.wobble", "under a dotted key"),
        ("sweep: {log.x: [1]}", (3, 16), "sweep.log.x", "single value"),
        ("sweep: {scene.gravity.x: [1]}", (3, 26), "sweep.scene.gravity.x", "single value"),
        ("conditions: {a: {seeds: 3}}", (3, 18), "conditions.a.seeds", "the same for all conditions"),
        ("conditions: {a: {wobble.period: 3}}", (3, 18), "conditions.a.wobble.period", "wobble: {period: ...}"),
        ("conditions: {a: 3}", (3, 17), "conditions.a", "a mapping of changes"),
        ("conditions: {a: {}, b: {}}", (3, 24), "conditions.b", "is the same as a"),
        ("sweep: {wobble.period: [5]}\nconditions: {period-5: {}}", (4, 24), "conditions.period-5", "exists twice"),
    ],
)
def test_errors_of_a_grid_point_at_what_was_written(grid: str, place: tuple[int, int], key: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(f"{BASE}{grid}\n")
    assert ((caught.value.line, caught.value.column), caught.value.key) == (place, key)
    assert words in caught.value.message


def test_a_key_that_the_swept_values_need_is_asked_for() -> None:
    with pytest.raises(ConfigError, match=r"wobble\.dimension is missing") as caught:
        parse_config("name: a\nsweep: {wobble.amplitude: [0.1]}\nconditions: {b: {}}\n")
    assert caught.value.line == 2


def grid_of(values: int, seeds: str) -> str:
    swept = ", ".join(f"{(i + 1) * 1e-4:.4f}" for i in range(values))
    return f"{BASE}seeds: {seeds}\nsweep:\n  physics.dt: [{swept}]\n  learning.scale: [{swept}]\n"


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        (grid_of(10_000, "0"), "sweep", "100,000,000 conditions (100,000,000 runs, "),
        (grid_of(10_000, "0..99"), "sweep", "100,000,000 conditions (10,000,000,000 runs, "),
        (grid_of(101, "0..99"), "sweep", "10,201 conditions (1,020,100 runs, "),
        (grid_of(100, "0..999"), "sweep", "are 10,000,000 runs, "),
        (f"{BASE}learning: {{epochs: 1000000000}}\n", "learning.epochs", "at most 1,000,000 (1 run, "),
        (f"{BASE}learning: {{epochs: 1e9}}\nseeds: 0..99\n", "learning.epochs", "at most 1,000,000 (100 runs, "),
        (f"{BASE}learning: {{epochs: 1e9}}\nlog: behaviours\n", "learning.epochs", "about 900 GB of results"),
    ],
    ids=["1e8", "1e10", "1e6", "seeds", "epochs", "epochs-seeds", "epochs-behaviours"],
)
def test_bi_5_a_huge_study_is_counted_and_refused(text: str, key: str, words: str, tmp_path: Path) -> None:
    found = read_apart(tmp_path / "huge.yaml", text, within=1.0)
    assert f" {key}: " in found.said
    assert words in found.said
    assert re.search(r"[\d,]+ runs?, [\d,.e+]+ simulated hours and about [\d,.e+]+ GB of results", found.said)
    assert found.seconds < 1.0  # s, measured 0.11 at most
    assert found.peak < 200e6  # bytes, measured 42e6 at most


def test_bi_5_what_a_study_costs_is_the_product_of_its_numbers() -> None:
    config = parse_config(
        f"{BASE}seeds: 0..9\nsweep: {{wobble.period: [25, 50]}}\n"
    )  # 4000 epochs of 20 trials of 60 s
    assert 20 * 4000 * 20 * 60 / 3600 == 26_666.666666666668
    assert config.cost() == "20 runs, 26,667 simulated hours and about 0.0022 GB of results"
    trials = parse_config(f"{BASE}log: trials\n").cost()
    assert trials == "1 run, 1,333 simulated hours and about 0.00068 GB of results"


def test_the_sizes_of_files_foretell_those_measured() -> None:
    # bytes of all files of a run of the starfish robot, least and greatest of 4 runs
    for epochs, log, least, greatest in (
        (100, "epochs", 31_563, 32_913),
        (1000, "epochs", 44_010, 54_795),
        (100, "trials", 52_145, 54_317),
        (1000, "trials", 168_895, 198_939),
        (100, "behaviours", 141_081, 143_925),
        (1000, "behaviours", 912_374, 967_639),
    ):
        assert 0.95 * least < stored_bytes(epochs, 20, log) < 1.05 * greatest  # measured 0.98 to 1.02 of the mean


# --- ten thousand conditions ---------------------------------------------------------------------------------------

HUNDRED = ", ".join(f"{i / 200}" for i in range(1, 101))
PERIODS = f"  wobble.period: [{', '.join(map(str, range(3, 103)))}]\n"
MILLION = {
    "product": f"{BASE}seeds: 0..99\nsweep:\n  wobble.amplitude: [{HUNDRED}]\n{PERIODS}",
    "sections": f"{BASE}seeds: 0..99\nsweep:\n  physics.dt: [{HUNDRED}]\n{PERIODS}",
    "named": f"{BASE}seeds: 0..99\nconditions:\n"
    + "".join(f"  c{i}: {{wobble: {{period: {3 + i % 100}, amplitude: {i // 100 / 200}}}}}\n" for i in range(10_000)),
    "seeds": f"{BASE}seeds: 0..999999\n",
}


@pytest.mark.parametrize("name", MILLION)
def test_a_million_runs_are_laid_out_at_once(name: str, tmp_path: Path) -> None:
    limit = 1.5 if name == "named" else 0.7  # 10,000 named conditions take 0.4 s to read
    found = read_apart(tmp_path / "study.yaml", MILLION[name], within=limit)
    assert (found.said, found.conditions) == ("", 1 if name == "seeds" else 10_000)
    assert found.seconds < limit  # s, measured 0.19, 0.12, 0.56, 0.08
    assert found.peak < 120e6  # bytes, measured 61e6, 47e6, 87e6, 90e6, of which 34e6 is the package


def robot(nodes: int) -> str:
    """A chain of nodes."""
    placed = ", ".join(f"{{position: [{i}, {i % 7}]}}" for i in range(nodes))
    joined = ", ".join(f"{{between: [{i}, {i + 1}], stiffness: 3}}" for i in range(nodes - 1))
    return f"robot: {{kind: custom, nodes: [{placed}], springs: [{joined}], muscles: [{{spring: 0, group: 0}}]}}\n"


def test_a_large_robot_that_all_conditions_share_is_checked_once(tmp_path: Path) -> None:
    grid = "sweep:\n  physics.dt: [{}]\n  learning.scale: [{}]\n"
    values = [", ".join(f"{i / 500}" for i in range(1, n + 1)) for n in (2, 100)]

    def both() -> Timed:
        few, many = (
            read_apart(tmp_path / "a.yaml", f"name: a1\n{robot(1000)}{grid.format(n, n)}", within=math.inf)
            for n in values
        )
        assert (few.conditions, many.conditions) == (4, 10_000)
        assert many.peak - few.peak < 10_000 * 3_000  # bytes, measured 1,300 each
        return Timed(many.seconds - few.seconds)

    allowed = 10_000 * 40e-6  # s, measured 13e-6 each; checking the robot takes 1600e-6
    assert quickest(both, within=allowed).seconds < allowed


def test_conditions_share_what_they_have_in_common_and_are_laid_out_once() -> None:
    config = parse_config(f"{BASE}sweep: {{physics.dt: [0.01, 0.02], wobble.period: [25, 50]}}\n")
    first, second, third, fourth = (condition.parameters for condition in expand(config))
    assert first.robot is second.robot is third.robot is fourth.robot is config.robot
    assert first.physics is second.physics
    assert first.physics is not third.physics
    assert first.wobble is third.wobble
    assert expand(config) is expand(config)


def test_a_changed_copy_has_conditions_of_its_own() -> None:
    config = parse_config(f"{BASE}sweep: {{wobble.period: [25, 50]}}\n")
    few = config.model_copy(update={"sweep": {"wobble.period": (30,)}})
    assert [[c.id for c in expand(one)] for one in (config, few)] == [["period-25", "period-50"], ["period-30"]]
    assert expand(config) == expand(config.model_copy())


def test_nothing_is_kept_of_a_configuration_that_is_gone() -> None:
    gone = [weakref.ref(condition.parameters) for condition in expand(parse_config(MILLION["product"]))]
    gc.collect()
    assert not any(one() for one in gone)


FLOATS = st.sampled_from([0.1, 0.2, 0.3, 0.9, 2.0, -1.0])
SWEEPS = st.fixed_dictionaries(
    {},
    optional={
        "wobble.amplitude": st.lists(FLOATS, min_size=1, max_size=3, unique=True),
        "wobble.mean": st.lists(FLOATS, min_size=1, max_size=3, unique=True),
        "physics.dt": st.lists(FLOATS, min_size=1, max_size=3, unique=True),
        "trial.duration": st.lists(FLOATS, min_size=1, max_size=3, unique=True),
        "learning.parents": st.lists(st.sampled_from([1, 5, 19, 20]), min_size=1, max_size=2, unique=True),
        "robot.stiffness.side": st.lists(FLOATS, min_size=1, max_size=2, unique=True),
        "scene.floor": st.just([None]),
        "scene.gravity": st.lists(FLOATS | st.just([0.0, -1.0]), min_size=1, max_size=2),
        "log": st.just(["epochs", "trials"]),
        "log.x": st.just([1]),
        "wobel.mean": st.just([1]),
    },
)


@settings(max_examples=150)
@given(SWEEPS)
def test_conditions_are_what_checking_each_as_a_whole_gives(sweep: dict[str, list[Any]]) -> None:
    try:
        config = SweepConfig.model_validate({**yaml.safe_load(BASE), "sweep": sweep})
    except ValidationError:
        return  # a value listed twice
    try:
        found = [condition.parameters for condition in expand(config)]
    except ConfigError:
        found = None
    assert found == each_as_a_whole(config)


def each_as_a_whole(config: SweepConfig) -> list[Parameters] | None:
    """The conditions of a product, each checked from the ground up; None if one of them is invalid."""
    conditions = []
    try:
        for values in itertools.product(*config.sweep.values()):
            data: Any = config.parameters.model_dump()
            for key, value in zip(config.sweep, values, strict=True):
                data = put(data, tuple(key.split(".")), value)
            conditions.append(Parameters.model_validate(data))
    except (ValidationError, LookupError):
        return None
    return conditions


def test_errors_are_limited_in_number() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(f"{BASE}sweep: {{wobble.period: [{', '.join(map(str, range(-200, 0)))}]}}\n")
    assert len(caught.value.others) == 19


@pytest.mark.parametrize(
    ("written", "seeds"),
    [
        ("7", (7,)),
        ("[3, 1, 2]", (3, 1, 2)),
        ("0..3", (0, 1, 2, 3)),
        ("5..5", (5,)),
        ("[0..2, 9]", (0, 1, 2, 9)),
        ('"0..1, 5"', (0, 1, 5)),
        ("9223372036854775807", (2**63 - 1,)),
    ],
)
def test_seeds(written: str, seeds: tuple[int, ...]) -> None:
    assert parse_config(f"name: a\nseeds: {written}\n").seeds == seeds


@pytest.mark.parametrize(
    "written",
    [
        "-1",
        "1.0",
        "true",
        "a",
        "[]",
        '""',
        "3..1",
        "..3",
        "3..",
        "0...3",
        "[1, 1]",
        "0..99999999",
        "[0..2, 1]",
        "null",
        "{}",
        "9223372036854775808",
        "[[1]]",
        "[-1]",
        '"²"',
    ],
)
def test_seeds_that_are_none_are_refused(written: str) -> None:
    with pytest.raises(ConfigError, match="seed") as caught:
        parse_config(f"name: a\nseeds: {written}\n")
    assert (caught.value.line, caught.value.key) == (2, "seeds")


def test_everything_is_frozen() -> None:
    config = parse_config(BASE)
    (condition,) = expand(config)
    with pytest.raises(ValidationError):
        config.name = "other"
    with pytest.raises(ValidationError):
        condition.parameters.physics.dt = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        condition.id = "other"  # type: ignore[misc]
    assert hash(condition.parameters) == hash(config.parameters)


def test_a_configuration_may_be_made_in_python() -> None:
    config = SweepConfig(name="a", seeds=(0, 1), sweep={"physics.dt": (0.01, 0.02)})
    assert [condition.id for condition in expand(config)] == ["dt-0.01", "dt-0.02"]
    with pytest.raises(ConfigError, match=r"sweep.physics.dt\[0\]: -1 is too small"):
        expand(SweepConfig(name="a", sweep={"physics.dt": (-1,)}))


def test_columns_are_flat_and_the_same_for_all() -> None:
    robot = (
        "{kind: custom, nodes: [{position: [0, 0]}, {position: [9, 0]}], springs: [{between: [0, 1], stiffness: 10}],"
        " muscles: [{spring: 0, group: 0}]}"
    )
    text = (
        "name: a\nconditions:\n"
        "  b: {wobble: {dimension: [mass, size], amplitude: 0.1, period: 9}}\n"
        f"  c: {{robot: {robot}, scene: {{gravity: [1, 2], floor: null}}}}\n"
    )
    b, c = (columns(condition.parameters) for condition in expand(parse_config(text)))
    assert list(b) == list(c)
    assert all(value is None or isinstance(value, (str, int, float)) for row in (b, c) for value in row.values())
    assert (b["wobble.dimension"], c["wobble.dimension"]) == ("mass+size", None)
    assert (b["scene.gravity.x"], b["scene.gravity.y"]) == (0, -100)
    assert (c["scene.gravity.x"], c["scene.gravity.y"]) == (1, 2)
    assert (b["robot.arms"], c["robot.arms"], b["robot.nodes"], c["robot.nodes"]) == (6, None, None, 2)
    assert (b["scene.floor.stiffness"], c["scene.floor.stiffness"]) == (10_000, None)
    assert c["robot.digest"]
    assert b["physics.dt"] == 0.02


# --- found out later -----------------------------------------------------------------------------------------------

LATE = """\
name: study
robot: {kind: starfish, height: 41}
physics: {integrator: explicit, theta: 0.7}
wobble: {dimension: mass, amplitude: 0.1, period: 25}
sweep:
  physics.dt: [0.001,
    0.002]
conditions:
  slow: {physics: {dt: 0.003}}
  soft: {robot: {friction: 0.1}}
"""


@pytest.mark.parametrize(
    ("condition", "keys", "place", "key", "message"),
    [
        ("dt-0.002", ["physics.dt", "physics.integrator"], (7, 5), "sweep.physics.dt[1]", "no (in condition dt-0.002)"),
        ("dt-0.002", ["trial.duration", "physics.dt"], (7, 5), "sweep.physics.dt[1]", "no (in condition dt-0.002)"),
        ("slow", ["physics.dt", "physics.integrator"], (9, 24), "conditions.slow.physics.dt", "no"),
        ("soft", ["physics.dt", "physics.integrator"], (3, 23), "physics.integrator", "no (in condition soft)"),
        ("soft", ["physics.dt"], (3, 1), "physics.dt", "no (in condition soft)"),
        ("soft", ["robot.height"], (2, 33), "robot.height", "no (in condition soft)"),
        ("soft", ["robot.arms", "trial.period"], (2, 1), "robot.arms", "no (in condition soft)"),
        ("dt-0.001", ["trial.period"], (1, 1), "trial.period", "no (in condition dt-0.001)"),
    ],
)
def test_a_fault_found_later_is_placed_where_it_was_written(
    condition: str, keys: list[str], place: tuple[int, int], key: str, message: str
) -> None:
    config = parse_config(LATE, source="study.yaml")
    error = condition_error(config, condition, "no", *keys)
    assert (error.path, (error.line, error.column), error.key) == ("study.yaml", place, key)
    assert error.message == message


def test_a_fault_found_later_knows_the_command_line_and_is_of_one_condition() -> None:
    config = parse_config(BASE, ["physics.dt=0.5"], seeds="0..3")
    error = condition_error(config, "study", "no", "physics.dt")
    assert str(error) == "--set physics.dt=0.5: physics.dt: no"


def test_a_fault_found_later_is_told_without_a_place_of_a_configuration_made_in_python() -> None:
    config = SweepConfig(name="a", sweep={"physics.dt": (0.01, 0.02)})
    assert str(condition_error(config, "dt-0.01", "no", "physics.dt")) == (
        "sweep.physics.dt[0]: no (in condition dt-0.01)"
    )


def test_remarks_are_made_once_for_all_conditions() -> None:
    text = f"{BASE}learning: {{epochs: 100}}\nsweep: {{wobble.period: [PERIODS]}}\n"
    (one,), (two,), (many,) = (
        remarks(parse_config(text.replace("PERIODS", periods))) for periods in ("9", "8, 9", "5, 6, 7, 8, 9")
    )
    assert [remark.partition(": ")[0] for remark in (one, two, many)] == [
        "period-9",
        "period-8 and period-9",
        "period-5 and 4 others",
    ]
    assert "wobble.end (2000) is after the last epoch (100)" in many


# --- ids ------------------------------------------------------------------------------------------------------------

NOT_TEXT = ["25", "007", "0x1F", "0b11", "3000000000", "2024-11-22", "24-1-2", "inf", "Infinity", "epoch"]


@pytest.mark.parametrize("name", NOT_TEXT)
def test_an_id_that_readers_of_the_results_take_for_a_number_is_refused_with_its_place(name: str) -> None:
    for text, place, key in (
        (f'seeds: 1\nname: "{name}"\n', (2, 7), "name"),
        (
            f'name: a1\nconditions:\n  ok: {{}}\n  "{name}": {{wobble: null}}\n',
            (4, 7 + len(name)),
            f"conditions.{name}",
        ),
    ):
        with pytest.raises(ConfigError, match=f"write a word before it, such as run-{name}") as caught:
            parse_config(text)
        error = caught.value
        assert ((error.line, error.column), error.key) == (place, key)
    studied = parse_config(f'name: "{name}"\nconditions: {{a1: {{}}, b1: {{log: trials}}}}\n')
    assert studied.name == name  # no id: the name of a folder that nothing is read from


def test_readers_of_the_results_take_the_ids_refused_for_something_else_and_the_others_for_text(tmp_path: Path) -> None:
    text = [
        "a1",
        "run-25",
        "0.1",
        "1e5",
        "true",
        "null",
        "nan",
        "1-2",
        "2024-11-22-b",
        "2024_11_22",
        "none",
        "period-3",
    ]
    for name in (*NOT_TEXT, *text):
        folder = tmp_path / name / f"condition={name}"
        folder.mkdir(parents=True)
        pq.write_table(pa.table({"x": [1.0]}), folder / "seed-0.parquet")
        kept = dataset.dataset(tmp_path / name, partitioning="hive").to_table()["condition"][0].as_py()
        asked = f"select condition from read_parquet('{tmp_path / name}/*/*.parquet', hive_partitioning=true)"
        read = duckdb.connect().execute(asked).fetchone()[0]
        assert ((kept, read) == (name, name)) == (name in text), (kept, read)
