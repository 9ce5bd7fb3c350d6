"""The files that are shipped: studies and the schema for editors; and writing a configuration back."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from wobblesim.config import ConfigError, SweepConfig, dump, expand, json_schema, load_config, parse_config, remarks

CONFIGS = Path(__file__).parents[2] / "configs"
FILES = sorted(CONFIGS.rglob("*.yaml"))
CONDITIONS = {
    "smoke": 2,
    "quickstart": 2,
    "custom-body": 2,
    "figure-2": 3,
    "figure-3a": 22,  # fixed, and 7 periods in 3 forms
    "figure-3b": 19,  # fixed, and 6 amplitudes in 3 dimensions
    "figure-3c": 7,  # fixed, and 6 lengths
    "figure-4": 2,
}


def lane_steps(config: SweepConfig) -> float:
    """Steps of single robots that a study simulates."""
    return sum(
        len(config.seeds) * p.learning.epochs * p.learning.population * p.trial.duration / p.physics.dt
        for p in (condition.parameters for condition in expand(config))
    )


@pytest.mark.parametrize("name", CONDITIONS)
def test_the_shipped_studies_have_their_conditions(name: str) -> None:
    (path,) = [path for path in FILES if path.stem == name]
    config = load_config(path)
    conditions = expand(config)
    assert config.name == name
    assert len(conditions) == config.count_conditions() == CONDITIONS[name]
    assert [c.id for c in conditions if c.parameters.wobble is None] == ["fixed"]
    assert remarks(config) == ()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_study_loads_round_trips_and_names_the_schema(path: Path) -> None:
    config = load_config(path)
    assert parse_config(dump(config)) == config
    assert expand(parse_config(dump(config))) == expand(config)
    head = path.read_text(encoding="utf-8").splitlines()[0]
    relative = head.removeprefix("# yaml-language-server: $schema=")
    assert relative != head
    assert (path.parent / relative).resolve() == CONFIGS / "schema.json"


@pytest.mark.parametrize("path", [path for path in FILES if path.parent.name == "paper"], ids=lambda path: path.stem)
def test_the_paper_s_studies_have_its_size(path: Path) -> None:
    config = load_config(path)
    assert config.seeds == tuple(range(100))
    for parameters in (condition.parameters for condition in expand(config)):
        assert parameters.learning.model_dump(include={"epochs", "population", "parents"}) == {
            "epochs": 4000,
            "population": 20,
            "parents": 5,
        }
        assert parameters.trial.duration == 60
        assert parameters.physics == SweepConfig(name="default").physics
        assert parameters.robot == SweepConfig(name="default").robot


def test_figure_3a_shifts_the_range_of_the_paused_form() -> None:
    by_id = {c.id: c.parameters.wobble for c in expand(load_config(CONFIGS / "paper" / "figure-3a.yaml"))}
    forms = [
        (w.mean, w.amplitude, w.upper_bound) for form in ("regular", "paused", "shifted") if (w := by_id[f"{form}-25"])
    ]
    assert forms == [(1.0, 0.1, None), (1.0, 0.1, 1.0), (0.95, 0.05, None)]


def test_the_small_studies_are_small() -> None:
    assert lane_steps(load_config(CONFIGS / "smoke.yaml")) <= 1e6
    assert lane_steps(load_config(CONFIGS / "quickstart.yaml")) <= 100e6
    assert lane_steps(load_config(CONFIGS / "custom-body.yaml")) <= 250e6


def test_the_schema_file_is_current() -> None:
    written = json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"
    assert (CONFIGS / "schema.json").read_text(encoding="utf-8") == written, (
        "configs/schema.json is out of date: write json_schema() to it (indent 2, no ASCII escapes, final newline)"
    )


def test_the_schema_describes_every_key() -> None:
    schema = json_schema()
    for section in (schema, *schema["$defs"].values()):
        if section.get("type") != "object":
            continue
        assert section["additionalProperties"] is False
        for key, described in section["properties"].items():
            assert "description" in described or "$ref" in described, key


def test_a_wobble_beyond_the_last_epoch_is_allowed_and_remarked() -> None:
    config = load_config(CONFIGS / "quickstart.yaml", ["learning.epochs=5"])
    (remark,) = remarks(config)
    assert "wobbling: wobble.end (600) is after the last epoch (5)" in remark


TEXT = st.text("abcdefgh0123456789._-", min_size=1, max_size=12).filter(lambda s: s[0].isalnum() and s[-1] != ".")


@settings(max_examples=60, deadline=None)
@given(
    name=TEXT | st.sampled_from(["1e-3", "0.5", "010", "no", "null", "2024", "12_3", "true"]),
    seeds=st.lists(st.integers(0, 30), min_size=1, max_size=6, unique=True),
    dt=st.floats(1e-6, 1.0),
    periods=st.lists(st.floats(2.5, 1e6) | st.integers(3, 100), max_size=4, unique=True),
    gravity=st.floats(-1e4, 1e4) | st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
)
def test_dump_reads_back_to_an_equal_configuration(
    name: str, seeds: list[int], dt: float, periods: list[float], gravity: object
) -> None:
    data = {
        "name": name,
        "seeds": seeds,
        "physics": {"dt": dt},
        "trial": {"duration": 50},
        "scene": {"gravity": gravity},
        "wobble": {"dimension": ["mass", "size"], "amplitude": 0.1, "period": 25},
        "sweep": {"wobble.period": periods} if periods else {},
        "conditions": {f"c.{name}": {"log": "trials"}},
    }
    config = SweepConfig.model_validate(data)
    assert parse_config(dump(config)) == config


def test_the_configuration_needs_no_simulator() -> None:
    code = (
        "import sys, types; package = types.ModuleType('wobblesim'); package.__path__ = ['wobblesim'];"
        "sys.modules['wobblesim'] = package; import wobblesim.config;"
        "heavy = {'numba', 'numpy', 'pandas', 'matplotlib', 'click', 'pyarrow'} & set(sys.modules);"
        "own = [m for m in sys.modules if m.startswith('wobblesim.') and not m.startswith('wobblesim.config')];"
        "sys.exit(str((heavy, own)) if heavy or own else 0)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=CONFIGS.parent, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


def test_the_schema_takes_the_studies_and_refuses_what_check_refuses() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    checker = jsonschema.Draft202012Validator(json_schema())
    checker.check_schema(json_schema())
    for path in FILES:
        checker.validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    wobbling = {"name": "a1", "wobble": {"dimension": "mass", "amplitude": 0.1, "period": 25}}
    checker.validate(
        wobbling | {"conditions": {"slow": {"wobble": {"period": 90}}, "still": {"wobble": None}, "as": None}}
    )
    checker.validate(wobbling | {"sweep": {"wobble.period": [25, 50], "scene.floor": [None]}})
    for wrong in (
        {"name": "../a"},
        {"seeds": "0.99"},
        {"physics": {"dtt": 1}},
        {"wobble": {"dimension": "mass", "amplitude": 0.1}},
        {"conditions": {"slow": {"wobble": {"perod": 90}}}},
        {"conditions": {"slow": {"seeds": 3}}},
        {"conditions": {"a/b": {}}},
        {"sweep": {"wobble.period": [1]}},
        {"sweep": {"physics.integrator": ["midpont"]}},
        {"sweep": {"physics.dt": []}},
    ):
        assert not checker.is_valid(wobbling | wrong), wrong
        with pytest.raises(ConfigError):
            parse_config(json.dumps(wobbling | wrong))
