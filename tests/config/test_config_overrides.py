"""Changes from the command line: ``--set key=value`` and ``--seeds``."""

from __future__ import annotations

from typing import Any

import pytest

from wobblesim.config import ConfigError, expand, parse_config
from wobblesim.config.overrides import merge, put

BASE = """\
name: study
robot: {kind: starfish}
wobble: {dimension: mass, amplitude: 0.1, period: 25}
sweep: {wobble.period: [25, 50]}
conditions: {amplitude-0.5: {wobble: {amplitude: 0.5}}}
"""
CUSTOM = """\
name: study
robot:
  kind: custom
  nodes: [{position: [0, 0]}, {position: [9, 0]}]
  springs: [{between: [0, 1], stiffness: 10}]
  muscles: [{spring: 0, group: 0}]
"""


def value_of(config: Any, key: str) -> Any:
    for part in key.split("."):
        config = getattr(config, part)
    return config


@pytest.mark.parametrize(
    ("setting", "key", "value"),
    [
        ("physics.dt=0.005", "physics.dt", 0.005),
        ("physics.dt=1e-3", "physics.dt", 0.001),
        (" physics.dt = 0.02 ", "physics.dt", 0.02),
        ("name=other", "name", "other"),
        ("name='2024'", "name", "2024"),
        ("wobble.dimension=mass,size", "wobble.dimension", ("mass", "size")),
        ("wobble.dimension=[mass, size]", "wobble.dimension", ("mass", "size")),
        ("wobble.dimension=size", "wobble.dimension", ("size",)),
        ("scene.floor=null", "scene.floor", None),
        ("scene.gravity=0,-50", "scene.gravity", (0.0, -50.0)),
        ("scene.floor.restitution=0", "scene.floor.restitution", 0.0),
        ("trial={duration: 5}", "trial.duration", 5.0),
        ("seeds=0..3", "seeds", (0, 1, 2, 3)),
        ("seeds=4,5", "seeds", (4, 5)),
    ],
)
def test_a_setting_changes_one_key(setting: str, key: str, value: Any) -> None:
    config = parse_config(BASE, [setting])
    assert value_of(config, key) == value
    others = parse_config(BASE).model_dump(exclude={key.split(".", maxsplit=1)[0]})
    assert config.model_dump(exclude={key.split(".", maxsplit=1)[0]}) == others


def test_settings_apply_in_order_and_reach_every_condition() -> None:
    config = parse_config(BASE, ["physics.dt=0.1", "physics.dt=0.02", "physics.iterations=9"])
    assert {(c.parameters.physics.dt, c.parameters.physics.iterations) for c in expand(config)} == {(0.02, 9)}


def test_settings_reach_into_sweeps_conditions_and_lists() -> None:
    config = parse_config(BASE, ["sweep.wobble.period=10,20,40", "conditions.amplitude-0.5.wobble.amplitude=0.4"])
    assert [c.id for c in expand(config)] == ["period-10", "period-20", "period-40", "amplitude-0.5"]
    assert expand(config)[-1].parameters.wobble.amplitude == 0.4  # type: ignore[union-attr]
    added = parse_config(BASE, ["conditions.fixed={wobble: null}", "sweep={}"])
    assert [c.id for c in expand(added)] == ["amplitude-0.5", "fixed"]
    for key in ("robot.nodes.1.mass", "robot.nodes[1].mass"):
        assert parse_config(CUSTOM, [f"{key}=3"]).robot.nodes[1].mass == 3  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("setting", "key", "words"),
    [
        ("physics.dt=0", "physics.dt", "0 is too small; allowed: a number above 0 and at most 1 (s)"),
        ("physics.dtt=1", "physics.dtt", "did you mean 'dt'?"),
        ("phisics.dt=1", "phisics", "did you mean 'physics'?"),
        ("robot.nodes.0.mass=1", "robot.nodes", "for a robot of kind starfish"),
        ("physics", "", "write key=value"),
        ("=1", "", "write key=value"),
        ("physics..dt=1", "", "write key=value"),
        ("physics.dt=", "physics.dt", "has no value"),
        ("physics.dt=010", "physics.dt", "leading zero"),
        ("physics.dt=[1", "", "not valid YAML"),
        ("name=\x07", "", "not allowed in YAML"),
        ("physics={dt: 1, dt: 2}", "physics.dt", "given twice"),
        ("physics.dt=*a", "physics.dt", "has no anchor"),
        ("physics.dt=!!float 1", "physics.dt", "tag"),
        (f"{'a.' * 5000}b=1", "", "is no key of a configuration"),
        ("name.x=1", "name.x", "single value"),
        ("wobble.dimension=mass,sizes", "wobble.dimension[1]", "did you mean 'size'?"),
        ("wobble.period=30", "wobble.period", "set sweep.wobble.period instead"),
        ("wobble=null", "wobble", "set sweep.wobble.period instead"),
        ("sweep.wobble.period=25,1", "sweep.wobble.period[1]", "1 is too small"),
        ("conditions.amplitude-0.5.wobble.mean=0.5", "conditions.amplitude-0.5.wobble.amplitude", "factor is 0 "),
    ],
)
def test_errors_name_the_setting(setting: str, key: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(BASE, [setting], source="study.yaml")
    error = caught.value
    assert error.key == key
    assert words in error.message
    if "factor" not in words:
        assert (error.path, error.line) == (f"--set {setting}", None)
        assert str(error).startswith(f"--set {setting}: ") or not setting.isprintable()


def test_an_argument_that_is_not_utf_8_is_refused() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(BASE, ["name=\udcff"])
    assert str(caught.value).isprintable()


def test_counting_beyond_a_list_is_refused() -> None:
    with pytest.raises(ConfigError, match="there is no item 2; the list has the items 0 to 1"):
        parse_config(CUSTOM, ["robot.nodes.2.mass=3"])
    with pytest.raises(ConfigError, match="there is no item 7") as caught:
        parse_config(CUSTOM + "sweep: {robot.springs.7.stiffness: [1, 2]}\n")
    assert caught.value.line == 7


def test_a_setting_mends_a_bad_file() -> None:
    assert parse_config("name: a\nphysics: {dt: 0}\n", ["physics.dt=0.1"]).physics.dt == 0.1


def test_seeds_from_the_command_line_replace_those_of_the_file() -> None:
    assert parse_config("name: a\nseeds: [x]\n", seeds="0..2,7").seeds == (0, 1, 2, 7)
    with pytest.raises(ConfigError) as caught:
        parse_config("name: a\n", seeds="0:2", source="study.yaml")
    assert str(caught.value).startswith("--seeds 0:2: seeds: '0:2' is not a seed; allowed: ")


def test_put_and_merge_copy() -> None:
    data = {"a": {"b": [1, 2]}, "c": None}
    assert put(data, ("a", "b", 1), 9) == {"a": {"b": [1, 9]}, "c": None}
    assert put(data, ("c", "d"), 9) == {"a": {"b": [1, 2]}, "c": {"d": 9}}
    assert merge(data, {"a": {"x": 1}, "c": {"d": 2}}) == {"a": {"b": [1, 2], "x": 1}, "c": {"d": 2}}
    assert merge({"kind": "a", "x": 1}, {"kind": "b"}) == {"kind": "b"}
    assert data == {"a": {"b": [1, 2]}, "c": None}
