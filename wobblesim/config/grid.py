"""From a sweep to its conditions: the product of the lists of ``sweep``, and the named ``conditions``."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from wobblesim.config.errors import ConfigError, Place, Problem, dotted, problems
from wobblesim.config.fields import MAX_NAME, Path
from wobblesim.config.lookup import models_in
from wobblesim.config.overrides import merge, put, split_key
from wobblesim.config.schema import CustomRobot, Parameters, Section, StarfishRobot, SweepConfig


@dataclass(frozen=True)
class Condition:
    """One condition of a study; with a seed it is a run.

    Attributes
    ----------
    id : str
        Readable and stable name, safe as the name of a file: the name given under ``conditions``, or the swept keys
        and values such as ``dimension-mass_amplitude-0.1``, or the name of the study if it has one condition.
    parameters : Parameters
        The complete parameters.
    """

    id: str
    parameters: Parameters


@dataclass(frozen=True)
class _Change:
    """A value put at a path of the parameters, and the path in the file where it was written."""

    path: Path
    value: Any
    written: Path


@dataclass(frozen=True)
class _Draft:
    """A condition before it is checked; ``home`` is the path in the file that brings it about."""

    id: str
    changes: tuple[_Change, ...]
    home: Path


def expand(config: SweepConfig) -> tuple[Condition, ...]:
    """Return the conditions of a study: the product of ``sweep`` in the order written, then the named ones.

    The ids do not change when values are added to a list or conditions to the study.

    Raises
    ------
    ConfigError
        If a condition is invalid; a configuration from ``load_config`` has none.
    """
    conditions, faults = expand_and_check(config)
    if faults:
        raise ConfigError(faults[0].message, Place(None), dotted(faults[0].paths[0]))
    return conditions


def expand_and_check(config: SweepConfig) -> tuple[tuple[Condition, ...], list[Problem]]:
    """Return the valid conditions, and the faults of the others with their paths in the file."""
    base = config.parameters.model_dump()
    conditions: list[Condition] = []
    faults: dict[Path, Problem] = {}
    ids: set[str] = set()
    parameters: dict[Parameters, str] = {}
    for draft in _drafts(config):
        found = _resolve(draft, base)
        if isinstance(found, Parameters):
            conditions.append(Condition(draft.id, found))
            found = _twins(draft, found, ids, parameters)
        for fault in found:
            faults.setdefault(fault.paths[0], fault)
    return tuple(conditions), list(faults.values())


def _twins(draft: _Draft, found: Parameters, ids: set[str], parameters: dict[Parameters, str]) -> list[Problem]:
    """Refuse a condition whose id or parameters came before; some file systems ignore the case of names."""
    twin = parameters.setdefault(found, draft.id)
    folded = draft.id.lower()
    if folded in ids:
        return [Problem((draft.home,), f"the condition {draft.id} exists twice; rename one")]
    ids.add(folded)
    if twin != draft.id:
        return [Problem((draft.home,), f"the condition {draft.id} is the same as {twin}; change or remove one")]
    return []


def _drafts(config: SweepConfig) -> Iterator[_Draft]:
    if not config.sweep and not config.conditions:
        yield _Draft(config.name, (), ("name",))
    if config.sweep:
        labels = _labels(config.sweep)
        for values in itertools.product(*(enumerate(items) for items in config.sweep.values())):
            changes = tuple(
                _Change(split_key(key), value, ("sweep", key, i))
                for key, (i, value) in zip(config.sweep, values, strict=True)
            )
            yield _Draft(_product_id(labels, [value for _, value in values]), changes, ("sweep",))
    for name, overrides in config.conditions.items():
        home = ("conditions", name)
        yield _Draft(name, (_Change((), overrides, home),), home)


def _resolve(draft: _Draft, base: dict[str, Any]) -> Parameters | list[Problem]:
    data: Any = base
    for change in draft.changes:
        if not change.path:
            data = merge(data, change.value)
            continue
        try:
            data = put(data, change.path, change.value)
        except LookupError as error:
            return [Problem((change.written[:2],), str(error))]
    try:
        return Parameters.model_validate(data)
    except ValidationError as error:
        return [_as_written(problem, draft) for problem in problems(error, data, Parameters)]


def _as_written(problem: Problem, draft: _Draft) -> Problem:
    """Point a fault of a condition at the place in the file that brought it about."""
    found = [written for path in problem.paths for written in [_written(path, draft, problem.about_key)] if written]
    closeness, path = max(found, key=lambda pair: pair[0], default=(0, problem.paths[0]))
    if path[0] == "conditions" or problem.about_key:
        return Problem((path,), problem.message, problem.about_key)
    what = "" if closeness == 2 else f"{dotted(problem.paths[0])} "
    return Problem((path,), f"{what}{problem.message} (in condition {draft.id})")


def _written(path: Path, draft: _Draft, about_key: bool) -> tuple[int, Path] | None:
    """Return how closely a change covers a path (2: exactly, 1: something around it), and where it was written."""
    for change in draft.changes:
        if not change.path:
            covered = _covered(path, change.value)
            if covered:
                return (2 if covered == len(path) else 1), (*change.written, *path)
        elif tuple(map(str, path[: len(change.path)])) == change.path:
            inner = () if about_key else (change.written[2], *path[len(change.path) :])
            return 2, (*change.written[:2], *inner)
        elif path == change.path[: len(path)]:
            return 1, change.written[:2]
    beside = (change.written[:2] for change in draft.changes if change.path[:1] == path[:1])
    return next(((0, written) for written in beside), None)


def _covered(path: Path, value: Any) -> int:
    """Return how many parts of a path exist in nested data."""
    for depth, part in enumerate(path):
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return depth
    return len(path)


# --- ids -----------------------------------------------------------------------------------------------------------


def _labels(keys: Any) -> list[str]:
    """Return the last part of each dotted key, or the whole key where the last parts are alike."""
    last = Counter(split_key(key)[-1] for key in keys)
    return [split_key(key)[-1] if last[split_key(key)[-1]] == 1 else ".".join(split_key(key)) for key in keys]


def _product_id(labels: list[str], values: list[Any]) -> str:
    parts = [f"{label}-{_word(value)}" for label, value in zip(labels, values, strict=True)]
    written = re.sub(r"[^A-Za-z0-9._-]", "-", "_".join(parts))
    if len(written) <= MAX_NAME:
        return written
    digest = hashlib.sha256("_".join(parts).encode()).hexdigest()[:10]
    return f"{written[: MAX_NAME - len(digest) - 1]}-{digest}"


def _word(value: Any) -> str:
    """Write a value for an id, so that 1 and 1.0 are the same."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "-".join(map(_word, value))
    if isinstance(value, float):
        return repr(value).removesuffix(".0").replace("e+", "e")
    return str(value)


# --- columns -------------------------------------------------------------------------------------------------------


def columns(parameters: Parameters) -> dict[str, str | int | float | None]:
    """Return the parameters as flat columns by dotted key, the same columns for every condition of every study.

    What a condition does not have (a floor, a wobble, the arms of a custom robot) is None. A list of dimensions is
    joined by ``+``, gravity is split into ``scene.gravity.x`` and ``.y``, and a custom robot is told by the number of
    its nodes, springs and muscles and by a digest of them all.
    """
    flat = _flat(parameters, (StarfishRobot,), "")
    gravity = flat.pop("scene.gravity")
    flat["scene.gravity.x"], flat["scene.gravity.y"] = gravity if isinstance(gravity, tuple) else (0.0, -gravity)
    if flat["wobble.dimension"] is not None:
        flat["wobble.dimension"] = "+".join(flat["wobble.dimension"])
    return flat | _custom_columns(parameters.robot)


def _flat(section: Section | None, kinds: tuple[type[Section], ...], prefix: str) -> dict[str, Any]:
    """Flatten a section, or name the columns of the sections that could be there."""
    flat: dict[str, Any] = {}
    for model in kinds if section is None else (Parameters,) if isinstance(section, Parameters) else kinds:
        for key, field in model.model_fields.items():
            inner = models_in(field.annotation)
            value = getattr(section, key, None)
            if inner:
                kinds_here = tuple(kind for kind in inner if kind is not CustomRobot)
                flat |= _flat(value, kinds_here, f"{prefix}{key}.")
            else:
                flat[f"{prefix}{key}"] = value
    return flat


def _custom_columns(robot: StarfishRobot | CustomRobot) -> dict[str, str | int | None]:
    if isinstance(robot, StarfishRobot):
        return dict.fromkeys(("robot.nodes", "robot.springs", "robot.muscles", "robot.digest"))
    digest = hashlib.sha256(robot.model_dump_json().encode()).hexdigest()[:16]
    counts = {"robot.nodes": len(robot.nodes), "robot.springs": len(robot.springs), "robot.muscles": len(robot.muscles)}
    return {**counts, "robot.digest": digest}
