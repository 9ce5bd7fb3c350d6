"""From a study to its conditions: products, names, ids, columns."""

from __future__ import annotations

import dataclasses
import re
import time

import pytest
from pydantic import ValidationError

from wobblesim.config import ConfigError, Parameters, SweepConfig, columns, expand, parse_config

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


@pytest.mark.parametrize(
    ("seeds", "values", "words"),
    [("0", 10_000, "100,000,000 conditions"), ("0..99", 101, "at most 10,000"), ("0..999", 100, "10,000,000 runs")],
)
def test_bi_5_a_huge_grid_is_counted_and_refused(seeds: str, values: int, words: str) -> None:
    swept = ", ".join(f"{(i + 1) * 1e-4:.4f}" for i in range(values))
    text = f"{BASE}seeds: {seeds}\nsweep:\n  physics.dt: [{swept}]\n  learning.scale: [{swept}]\n"
    start = time.perf_counter()
    with pytest.raises(ConfigError, match=words) as caught:
        parse_config(text)
    assert "simulated hours" in caught.value.message
    assert caught.value.key == "sweep"
    assert time.perf_counter() - start < 10  # measured 0.1 s for the largest with libyaml


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
