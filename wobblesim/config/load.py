"""A YAML file in, one frozen and checked configuration out, and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path as FilePath
from typing import Any

import yaml
from pydantic import ValidationError

from wobblesim.config.beside import Beside
from wobblesim.config.errors import ConfigError, Place, Problem, dotted, problems
from wobblesim.config.fields import Path
from wobblesim.config.grid import MAX_FAULTS, expand, expand_and_check, fault_of
from wobblesim.config.overrides import apply_seeds, apply_settings
from wobblesim.config.reading import Document, plain_value, read_document, read_text
from wobblesim.config.schema import SweepConfig

_documents: Beside[Callable[[], Document]] = Beside()
"""How the document that a configuration was made of can be read once more, to find a place in it."""


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
    text, source = read_text(path)
    return parse_config(text, overrides, seeds, source=source)


def parse_config(
    text: str, overrides: Sequence[str] = (), seeds: str | None = None, *, source: str = "<text>"
) -> SweepConfig:
    """Do as `load_config` with YAML text, which errors call by the name ``source``."""
    read = partial(_document, text, source, tuple(overrides), seeds)
    config = _checked(read())
    _documents.keep(config, read)
    return config


def _document(text: str, source: str, overrides: Sequence[str], seeds: str | None) -> Document:
    document = read_document(text, source)
    apply_settings(document, overrides)
    if seeds is not None:
        apply_seeds(document, seeds)
    return document


def _checked(document: Document) -> SweepConfig:
    try:
        config = SweepConfig.model_validate(document.data)
    except ValidationError as error:
        raise _config_error(problems(error, document.data), document) from None
    _, faults = expand_and_check(config)
    if faults:
        raise _config_error(faults, document)
    return config


def _config_error(found: Sequence[Problem], document: Document) -> ConfigError:
    first, *others = (_placed(problem, document) for problem in found[:MAX_FAULTS])
    place = Place(first.path, first.line, first.column)
    return ConfigError(first.message, place, first.key, others)


def _placed(problem: Problem, document: Document) -> ConfigError:
    path = _path(problem, document)
    return ConfigError(problem.message, document.place(path, about_key=problem.about_key), dotted(path))


def _path(problem: Problem, document: Document) -> Path:
    """Of the values at fault, take the first that was written down; a default cannot be at fault alone."""
    return next((path for path in problem.paths if path in document.values), problem.paths[0])


def condition_error(config: SweepConfig, condition: str, message: str, *keys: str) -> ConfigError:
    """Build the error of a condition that only its simulator can refuse, with the place where it was written.

    Parameters
    ----------
    config
        As `load_config` or `parse_config` returned it; of one made in Python only the key is told.
    condition
        Its id.
    message
        What is wrong and what to do, in one sentence.
    *keys
        Dotted keys that may be at fault, the likeliest first; the first that was written down is named.
    """
    read = _documents.of(config)
    document = read() if read else Document("")
    return _placed(fault_of(config, condition, message, keys, document.values), document)


def remarks(config: SweepConfig) -> tuple[str, ...]:
    """Say what is allowed but perhaps not meant, one sentence for all conditions that it is true of."""
    found: dict[str, list[str]] = {}
    for condition in expand(config):
        wobble, epochs = condition.parameters.wobble, condition.parameters.learning.epochs
        if wobble is not None and wobble.end > epochs:
            remark = (
                f"wobble.end ({wobble.end}) is after the last epoch ({epochs}), so that runs end while the robot "
                "wobbles and their performance is not the adult's"
            )
            found.setdefault(remark, []).append(condition.id)
    return tuple(f"{_some(conditions)}: {remark}" for remark, conditions in found.items())


def _some(conditions: Sequence[str]) -> str:
    first, *others = conditions
    if not others:
        return first
    return f"{first} and {f'{len(others):,} others' if others[1:] else others[0]}"


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
