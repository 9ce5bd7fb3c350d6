"""Every mistake is answered by one line that says where it is, what is wrong and what to write instead."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from wobblesim.config import ConfigError, SweepConfig, expand, parse_config
from wobblesim.config.errors import dotted
from wobblesim.config.fields import shown
from wobblesim.config.lookup import field_at, leaf_paths

STARFISH = {
    "name": "study",
    "seeds": 0,
    "robot": {
        "kind": "starfish",
        "arms": 6,
        "sections": 8,
        "height": 40.0,
        "width": 30.0,
        "center_side": 30.0,
        "groups_per_arm": 2,
        "node_mass": 1.0,
        "friction": 0.5,
        "stiffness": {"diagonal": 1e5, "side": 3e3, "width": 12e3, "center": 5e5, "tip": 5e5},
        "damping_ratio": 1.0,
    },
    "scene": {"gravity": 100.0, "floor": {"restitution": 0.5, "restitution_threshold": 1.0, "stiffness": 2e4}},
    "physics": {
        "integrator": "midpoint",
        "dt": 0.01,
        "precision": "float32",
        "iterations": 5,
        "theta": 0.55,
        "max_speed": 5e4,
        "max_strain": 20.0,
        "max_energy": 20.0,
        "refinements": 3,
    },
    "trial": {"duration": 60.0, "period": 1.0, "max_amplitude": 0.1},
    "learning": {
        "epochs": 4000,
        "population": 20,
        "parents": 5,
        "rate": 0.1,
        "scale": 0.025,
        "direction": "forward",
    },
    "wobble": {
        "dimension": "mass",
        "amplitude": 0.1,
        "period": 25,
        "end": 2000,
        "decay_start": 1900,
        "mean": 1.0,
        "upper_bound": 1.5,
    },
    "sweep": {"wobble.period": [25, 50]},
    "conditions": {"fixed": {"wobble": None}},
    "log": "epochs",
}
CUSTOM = {
    "name": "study",
    "robot": {
        "kind": "custom",
        "nodes": [
            {"position": [0, 0], "mass": 1.0, "friction": 0.5, "fixed": False, "velocity": [0, 0]},
            {"position": [10, 0]},
        ],
        "springs": [{"between": [0, 1], "stiffness": 3e3, "damping_ratio": 1.0, "rest_length": 10.0}],
        "muscles": [{"spring": 0, "group": 0, "sign": 1.0}],
        "center": [0, 1],
        "body_length": 10.0,
    },
}


def keys_of(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every key of nested data, at every level."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield (*path, key)
            if key not in ("sweep", "conditions"):
                yield from keys_of(value, (*path, key))
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from keys_of(value, (*path, i))


def parent_of(data: Any, path: tuple[Any, ...]) -> Any:
    for part in path[:-1]:
        data = data[part]
    return data


def written(data: Any) -> str:
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=False)


def place_of(text: str, word: str) -> tuple[int, int]:
    """Line and column, from 1, of a word that occurs once in a text."""
    before = text[: text.index(word)]
    return before.count("\n") + 1, len(before) - before.rfind("\n")


def error_of(text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, source="study.yaml")
    for line in caught.value.report().splitlines():
        assert line.isprintable()
        assert line.startswith("study.yaml")
    return caught.value


CASES = [(data, path) for data in (STARFISH, CUSTOM) for path in keys_of(data)]
BOTH = [pytest.param(data, path, id=".".join(map(str, path))) for data, path in CASES]
NUMBERS = [
    pytest.param(data, path, id=".".join(map(str, path)))
    for data, path in CASES
    if type(parent_of(data, path)[path[-1]]) in (int, float)
]


def test_the_examples_are_valid_and_name_every_key() -> None:
    for data in (STARFISH, CUSTOM):
        parse_config(written(data))
    named = {tuple(part for part in path if isinstance(part, str)) for _, path in CASES}
    assert named == set(leaf_paths(SweepConfig))


@pytest.mark.parametrize(("data", "path"), BOTH)
def test_bi_1_a_misspelt_key_is_answered_by_the_right_one(data: dict[str, Any], path: tuple[Any, ...]) -> None:
    data = copy.deepcopy(data)
    parent, key = parent_of(data, path), path[-1]
    misspelt = f"{key[:-2]}{key[-1]}q" if len(key) > 3 else f"{key}q"  # a letter lost and a letter too many
    items = [(misspelt if k == key else k, v) for k, v in parent.items()]
    parent.clear()
    parent.update(items)
    text = written(data)
    error = error_of(text)
    assert (error.line, error.column) == place_of(text, f"{misspelt}:")
    assert error.key.endswith(misspelt)
    assert f"(did you mean '{key}'?)" in error.message
    assert not any("is missing" in other.message and other.key.endswith(f".{key}") for other in error.others)


@pytest.mark.parametrize(("data", "path"), BOTH)
def test_bi_1_a_key_at_the_wrong_level_is_told_its_place(data: dict[str, Any], path: tuple[Any, ...]) -> None:
    data, key = copy.deepcopy(data), path[-1]
    wrong = data.setdefault("trial" if path[0] != "trial" else "learning", {})
    if key in wrong:
        pytest.skip("this key exists there too")
    wrong[key] = parent_of(data, path).pop(key)
    error = error_of(written(data))
    assert error.message.startswith("unknown key")
    assert "belongs" in error.message
    home = ".".join(part for part in path[:-1] if isinstance(part, str)) or "the top level"
    assert home in error.message


@pytest.mark.parametrize(("word", "meant"), [("wobel", "wobble"), ("Learning", "learning"), ("physic", "physics")])
def test_a_misspelt_key_in_a_condition_is_found(word: str, meant: str) -> None:
    error = error_of(f"name: a\nconditions:\n  b:\n    {word}: null\n")
    assert (error.line, error.column, error.key) == (4, 5, f"conditions.b.{word}")
    assert f"did you mean '{meant}'?" in error.message


@pytest.mark.parametrize(
    "bad", [".nan", ".inf", "-.inf", "1.0e+999", "-1e300", "1e300", "fast", "true", "[1, 2]", "{}"]
)
@pytest.mark.parametrize(("data", "path"), NUMBERS)
def test_bi_3_a_bad_number_is_refused_with_the_range(data: dict[str, Any], path: tuple[Any, ...], bad: str) -> None:
    if path[-1] in ("gravity", "seeds") and bad == "[1, 2]":
        pytest.skip("gravity may be a vector, seeds a list")
    data = copy.deepcopy(data)
    parent_of(data, path)[path[-1]] = "THE-BAD-ONE"
    text = written(data).replace("THE-BAD-ONE", bad)
    error = error_of(text)
    assert error.line == place_of(written(data), "THE-BAD-ONE")[0]
    assert error.key.endswith(str(path[-1]))
    assert "allowed: " in error.message
    assert re.search(r"\d|y a list", error.message)


def least_of(path: tuple[Any, ...]) -> tuple[float, bool]:
    """The lower bound of a number, and whether it is excluded."""
    field = field_at(path)
    assert field is not None
    bounds = {name: getattr(mark, name) for mark in field.metadata for name in ("gt", "ge") if hasattr(mark, name)}
    ((name, bound),) = bounds.items()
    return bound, name == "gt"


WITHOUT_A_RANGE = {"gravity", "seeds"}
RANGED = [number for number in NUMBERS if number.values[1][-1] not in WITHOUT_A_RANGE]


@pytest.mark.parametrize("value", [0, -1, -1e-9, -5000])
@pytest.mark.parametrize(("data", "path"), RANGED)
def test_bi_3_zero_and_negative_numbers_are_refused_where_the_range_ends_above(
    data: dict[str, Any], path: tuple[Any, ...], value: float
) -> None:
    least, excluded = least_of(path)
    text = "robot.muscles[0].sign" if path[-1] == "sign" else ".".join(map(str, path))
    kept = {name: part for name, part in data.items() if name not in ("sweep", "conditions")}
    refused = refusal_of(written(kept), f"{text}={value}")
    is_whole = type(parent_of(data, path)[path[-1]]) is int and value == -1e-9
    if value < least or (excluded and value == least) or is_whole:
        assert refused.startswith(f"--set {text}={value}: {dotted(path)}: {shown(value)} is ")
        assert "allowed: " in refused
    else:
        assert "allowed: " not in refused  # but perhaps refused by a rule between keys


def refusal_of(text: str, setting: str) -> str:
    """The error of a text with a setting, empty if it has none."""
    try:
        parse_config(text, [setting])
    except ConfigError as error:
        return str(error)
    return ""


BAD_ITEMS = [
    ("robot.nodes[0].position", "[.nan, 0]"),
    ("robot.nodes[0].position", "[0, 1.0e+999]"),
    ("robot.nodes[0].position", "[0, left]"),
    ("robot.nodes[0].velocity", "[.inf, 0]"),
    ("robot.nodes[0].velocity", "[0]"),
    ("robot.springs[0].between", "[0, .nan]"),
    ("robot.springs[0].between", "[0, 0.5]"),
    ("robot.springs[0].between", "[0, -1]"),
    ("robot.springs[0].between", "[0, 5000]"),
    ("robot.center", "[.inf]"),
    ("robot.center", "[-1]"),
    ("scene.gravity", "[.nan, 0]"),
    ("scene.gravity", "[0, 1.0e+999]"),
    ("scene.gravity", "[1e300, 0]"),
    ("scene.gravity", "fast"),
    ("seeds", ".nan"),
    ("seeds", "[0, 1.0e+999]"),
    ("seeds", "-1"),
    ("seeds", "[0, 99999999999999999999]"),
]


@pytest.mark.parametrize(("key", "bad"), BAD_ITEMS)
def test_bi_3_a_bad_number_in_a_list_is_refused(key: str, bad: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(written(CUSTOM), [f"{key}={bad}"])
    assert caught.value.key.startswith(key)
    assert re.search(r"allowed: |numbered 0 to 1", caught.value.message)


SWEPT = [number for number in RANGED if number.values[0] is STARFISH]


@pytest.mark.parametrize("bad", [".nan", "-.inf", "1.0e+999", "1e300", "-1e300", "fast", "true"])
@pytest.mark.parametrize(("data", "path"), SWEPT)
def test_bi_3_a_bad_number_is_refused_in_a_sweep_and_in_a_condition(
    data: dict[str, Any], path: tuple[Any, ...], bad: str
) -> None:
    key, good = ".".join(path), parent_of(data, path)[path[-1]]
    base = written({name: value for name, value in data.items() if name not in ("sweep", "conditions")})
    swept = error_of(f"{base}sweep:\n  {key}: [{good},\n    {bad}]\n")
    assert (swept.line, swept.column, swept.key) == (base.count("\n") + 3, 5, f"sweep.{key}[1]")
    assert "allowed: " in swept.message
    inner = bad
    for part in reversed(path):
        inner = f"{{{part}: {inner}}}"
    named = error_of(f"{base}conditions:\n  one: {inner}\n")
    assert (named.line, named.key) == (base.count("\n") + 2, f"conditions.one.{key}")
    assert "allowed: " in named.message


@pytest.mark.parametrize(
    ("number", "words"),
    [
        ("1e3", "1000.0 has a point or an exponent; a whole number is written 1000; allowed: a whole number"),
        ("20.0", "20.0 has a point or an exponent; a whole number is written 20; allowed: a whole number"),
        ("2.5", "2.5 is not a whole number; allowed: a whole number"),
        ("1e300", "1e+300 is not a whole number; allowed: a whole number"),
    ],
)
def test_a_whole_number_written_as_another_is_told_how(number: str, words: str) -> None:
    assert words in error_of(f"name: a\nlearning: {{epochs: {number}}}\n").message


@pytest.mark.parametrize(
    ("wobble", "least"),
    [
        ("{dimension: mass, mean: 0.9, amplitude: 0.95, period: 25}", "least mass factor is -0.05 "),
        ("{dimension: mass, mean: 1, amplitude: 1, period: 25}", "least mass factor is 0 "),
        ("{dimension: [size, gravity], amplitude: 1.5, period: 25}", "least size and gravity factor is -0.5 "),
        ("{dimension: mass, mean: 0.1, amplitude: 0.1, period: 25, upper_bound: 1}", "least mass factor is 0 "),
    ],
)
def test_bi_4_a_factor_of_zero_or_less_is_refused(wobble: str, least: str) -> None:
    error = error_of(f"name: a\nwobble: {wobble}\n")
    assert least in error.message
    assert (error.line, error.key) == (2, "wobble.amplitude")


def test_bi_4_holds_for_every_condition() -> None:
    text = """\
name: a
wobble: {dimension: mass, amplitude: 0.1, period: 25}
sweep:
  wobble.mean: [1.0, 0.9]
  wobble.amplitude: [0.5,
    0.95]
conditions:
  low:
    wobble:
      mean: 0.1
"""
    swept = error_of(text)
    (named,) = swept.others
    assert (swept.line, swept.column, swept.key) == (6, 5, "sweep.wobble.amplitude[1]")
    assert "-0.05" in swept.message
    assert "mean-0.9_amplitude-0.95" in swept.message
    assert (named.line, named.column, named.key) == (10, 13, "conditions.low.wobble.mean")
    assert "least mass factor is 0 " in named.message


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("name: a\nlearning:\n  population: 5\n", 3, "at most 4 parents"),
        ("name: a\ntrial: {duration: 0.001}\n", 2, "shorter than one step of 0.02 s"),
        ("name: a\ntrial: {duration: 86400}\nphysics:\n  dt: 1.0e-6\n", 2, "at most 100,000,000"),
        ("name: a\nrobot: {kind: starfish, sections: 1}\n", 2, "2 motor groups cannot share 1 sections"),
        ("name: a\nrobot: {kind: starfish, width: 200}\n", 2, "use a height above 85"),
        (
            "name: a\nrobot: {kind: starfish, width: 90}\nwobble: {dimension: size, amplitude: 0.5, period: 9}\n",
            3,
            "20 u",
        ),
        (
            "name: a\nwobble: {dimension: mass, amplitude: 0.5, period: 9, end: 5, decay_start: 6}\n",
            2,
            "after the end 5",
        ),
        ("name: a\nwobble: {dimension: [mass, mass], amplitude: 0.5, period: 9}\n", 2, "listed twice"),
        ("name: a\nwobble: {dimension: [], amplitude: 0.5, period: 9}\n", 2, "mass, stiffness, size or gravity"),
        ("name: a\nphysics: {integrator: Midpoint}\n", 2, "did you mean 'midpoint'?"),
        ("name: a\nrobot: {kind: star}\n", 2, "did you mean 'starfish'?"),
        ("name: a\nrobot: {arms: 5}\n", 2, "is missing; allowed: starfish or custom"),
        ("seeds: 1\n", 1, "is missing"),
        ("name: a\nphysics:\n", 2, "null is not a mapping"),
        ("name: a\nscene: {gravity: [0, 1, 2]}\n", 2, "[gx, gy]"),
    ],
)
def test_rules_between_keys_name_the_key_and_the_remedy(text: str, line: int, words: str) -> None:
    error = error_of(text)
    assert error.line == line
    assert words in error.message


@pytest.mark.parametrize(
    ("setting", "key", "words"),
    [
        ("robot.springs.0.between=[0, 2]", "robot.springs[0].between[1]", "numbered 0 to 1"),
        ("robot.springs.0.between=[0, 0]", "robot.springs[0].between", "joins node 0 to itself"),
        ("robot.springs.0.between=[0]", "robot.springs[0].between", "two node numbers"),
        ("robot.nodes.1.position=[0, 0]", "robot.springs[0].between", "at the same place"),
        ("robot.nodes.1.position=[10, -1]", "robot.nodes[1].position", "below the floor (y = -1)"),
        ("robot.nodes.0.fixed=1", "robot.nodes[0].fixed", "true or false"),
        ("robot.muscles.0.spring=1", "robot.muscles[0].spring", "there is no spring 1"),
        ("robot.muscles=[{spring: 0, group: 0}, {spring: 0, group: 1}]", "robot.muscles[1].spring", "muscle already"),
        ("robot.muscles.0.group=1", "robot.muscles", "group 0 has no muscle"),
        ("robot.muscles.0.sign=0", "robot.muscles[0].sign", "does nothing"),
        ("robot.muscles.0.sign=10", "robot.muscles[0].sign", "below 1"),
        ("robot.muscles=[]", "robot.muscles", "an empty list is too short"),
        ("robot.center=[0, 0]", "robot.center", "listed twice"),
        ("robot.center=[2]", "robot.center[0]", "there is no node 2"),
    ],
)
def test_a_custom_robot_is_checked_for_loose_ends(setting: str, key: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(written(CUSTOM), [setting])
    assert caught.value.key == key
    assert words in caught.value.message


def test_all_errors_of_a_file_are_reported_unknown_keys_first() -> None:
    error = error_of("name: a\nphysics: {dt: 0}\nlearning: {epochs: x}\nlog: none\ntrail: {}\n")
    assert error.key == "trail"
    assert sorted(other.line or 0 for other in error.others) == [2, 3, 4]
    assert len(error.report().splitlines()) == 4
    assert str(error).count("\n") == 0


def test_the_text_of_an_error_is_file_line_column_key_message() -> None:
    error = error_of("name: a\nwobble: {dimension: mass, amplitude: 0.5, perod: 25}\n")
    assert str(error) == "study.yaml:2:43: wobble.perod: unknown key (did you mean 'period'?)"


@pytest.mark.parametrize(
    "name",
    [
        "../x",
        "/x",
        "a/b",
        "..",
        ".",
        "-x",
        "a\\0b",
        "a" * 81,
        "a" * 300,
        "CON",
        "nul.txt",
        "a.",
        "a b",
        "é",
        "a\\n",
        "",
        "a\\\\b",
    ],
)
@pytest.mark.parametrize("form", ['name: "{}"\n', 'name: a\nconditions: {{"{}": {{}}}}\n'])
def test_bi_8_names_that_are_no_safe_file_names_are_refused(name: str, form: str) -> None:
    with pytest.raises(ConfigError):
        parse_config(form.format(name))


@pytest.mark.parametrize("name", ["a", "figure-3b", "0.1", "A_b.c-d", "a" * 80, "2024-11-22-b", "null-hypothesis"])
def test_safe_names_are_accepted(name: str) -> None:
    assert parse_config(f'name: "{name}"').name == name


LOOKALIKES = "\ufb01xed fi\u0445ed \uff46ixed f\u0131xed fixe\u0301d fi\u200bxed fixed\u202e \u212aept \u00b2"


@pytest.mark.parametrize("twin", LOOKALIKES.split(), ids=ascii)
def test_bi_8_names_that_look_like_others_are_refused(twin: str) -> None:
    for text in (f'name: "{twin}"\n', f'name: a\nconditions:\n  fixed: {{log: trials}}\n  "{twin}": {{}}\n'):
        error = error_of(text)
        assert "cannot name a file" in error.message
        assert ascii(twin) in error.message  # shown by its number, for it looks like another


@pytest.mark.parametrize(
    "value", ["'../x'", "'/x'", "'..'", "'a/b'", "'a\\b'", "'a\\0b'", "'-x'", "'CON'", "'../../etc/passwd'"]
)
def test_bi_8_no_swept_value_leaves_its_folder(value: str) -> None:
    with pytest.raises(ConfigError):  # of all that can be swept, nothing is free text
        parse_config(f"name: a\nsweep: {{log: [epochs, {value}]}}\n")
    robot = "{kind: custom, nodes: [{position: [0, 0]}, {position: [9, 0]}], springs: [{between: [0, 1], stiffness: 1}]"
    for key in ("'robot.nodes[0].mass'", "robot/../x.mass", "../x"):
        grid = f"sweep: {{{key}: [0.5, 1]}}"
        try:
            found = expand(parse_config(f"name: a\nrobot: {robot}, muscles: [{{spring: 0, group: 0}}]}}\n{grid}\n"))
        except ConfigError:
            continue
        assert [condition.id for condition in found] == ["mass-0.5", "mass-1"]


def test_bi_8_names_that_differ_only_in_case_are_refused() -> None:
    error = error_of("name: a\nconditions:\n  Fixed: {log: trials}\n  fixed: {}\n")
    assert (error.line, error.key) == (4, "conditions.fixed")
