"""A YAML file in, one frozen and checked configuration out, and back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import yaml
from pydantic import ValidationError

from wobblesim.config.errors import ConfigError, Place, Problem, dotted, problems
from wobblesim.config.grid import expand, expand_and_check
from wobblesim.config.lookup import field_at, leaf_paths, models_in
from wobblesim.config.overrides import apply_seeds, apply_settings
from wobblesim.config.reading import Document, plain_value, read_document, read_source
from wobblesim.config.schema import SweepConfig

MAX_ERRORS = 20


def load_config(path: str | FilePath, overrides: Sequence[str] = (), seeds: str | None = None) -> SweepConfig:
    """Read, change and check a configuration.

    Parameters
    ----------
    path
        A YAML file, or ``-`` for standard input.
    overrides
        Settings such as ``physics.dt=0.005`` or ``sweep.wobble.period=25,50``, applied in order.
    seeds
        Seeds instead of the file's, such as ``0..9`` or ``0,3,7``.

    Raises
    ------
    ConfigError
        With file, line, column and key of the first fault, and all others in ``others``.
    """
    return _checked(read_source(path), overrides, seeds)


def parse_config(
    text: str, overrides: Sequence[str] = (), seeds: str | None = None, *, source: str = "<text>"
) -> SweepConfig:
    """Do as `load_config` with YAML text, which errors call by the name ``source``."""
    return _checked(read_document(text, source), overrides, seeds)


def _checked(document: Document, overrides: Sequence[str], seeds: str | None) -> SweepConfig:
    apply_settings(document, overrides)
    if seeds is not None:
        apply_seeds(document, seeds)
    try:
        config = SweepConfig.model_validate(document.data)
    except ValidationError as error:
        raise _config_error(problems(error, document.data), document) from None
    _, faults = expand_and_check(config)
    if faults:
        raise _config_error(faults, document)
    return config


def _config_error(found: Sequence[Problem], document: Document) -> ConfigError:
    first, *others = (_placed(problem, document) for problem in found[:MAX_ERRORS])
    place = Place(first.path, first.line, first.column)
    return ConfigError(first.message, place, first.key, others)


def _placed(problem: Problem, document: Document) -> ConfigError:
    path = _path(problem, document)
    return ConfigError(problem.message, document.place(path, about_key=problem.about_key), dotted(path))


def _path(problem: Problem, document: Document) -> tuple[str | int, ...]:
    """Of the values at fault, take the first that was written down; a default cannot be at fault alone."""
    return next((path for path in problem.paths if path in document.values), problem.paths[0])


def remarks(config: SweepConfig) -> tuple[str, ...]:
    """Say what is allowed but perhaps not meant, one sentence for each condition concerned."""
    found = []
    for condition in expand(config):
        wobble, epochs = condition.parameters.wobble, condition.parameters.learning.epochs
        if wobble is not None and wobble.end > epochs:
            found.append(
                f"{condition.id}: wobble.end ({wobble.end}) is after the last epoch ({epochs}), so that runs end while "
                "the robot wobbles and their performance is not the adult's"
            )
    return tuple(found)


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a configuration file, for editors."""
    schema = SweepConfig.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "wobblesim configuration"
    schema["properties"]["sweep"]["properties"] = {
        ".".join(path): {"type": "array", "minItems": 1, "description": field.description}
        for path in leaf_paths()
        if (field := field_at(path)) and not models_in(field.annotation)
    }
    return dict(sorted(schema.items(), key=lambda item: item[0] == "$defs"))


class _Dumper(yaml.SafeDumper):
    """Writes text so that it is read back as text, and short lists on one line."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _write_text(dumper: _Dumper, value: str) -> yaml.ScalarNode:
    try:
        is_plain = plain_value(value) == value
    except ValueError:
        is_plain = False
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=None if is_plain else '"')


def _write_list(dumper: _Dumper, values: list[Any]) -> yaml.SequenceNode:
    is_short = not any(isinstance(value, dict) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=is_short)


_Dumper.add_representer(str, _write_text)
_Dumper.add_representer(list, _write_list)


def dump(config: SweepConfig) -> str:
    """Write a configuration as YAML with every default spelt out; `parse_config` reads back an equal one."""
    data = config.model_dump(mode="json")
    ordered = {"name": data.pop("name"), "seeds": data.pop("seeds"), **data}
    return yaml.dump(ordered, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
