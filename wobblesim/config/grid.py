"""From a sweep to its conditions: the product of the lists of ``sweep``, and the named ``conditions``."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections import Counter
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

from pydantic import TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from wobblesim.config.beside import Beside
from wobblesim.config.errors import ConfigError, Place, Problem, dotted, problems
from wobblesim.config.fields import MAX_NAME, Path
from wobblesim.config.lookup import models_in
from wobblesim.config.overrides import merge, put, split_key
from wobblesim.config.schema import CustomRobot, Parameters, Section, StarfishRobot, SweepConfig


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True, eq=False)
class _Change:
    """A value put at a path of the parameters, the path in the file where it was written, and its part of an id.

    Without a path it is a mapping of changes to several sections, under the name of a condition.
    """

    path: tuple[str, ...]
    value: Any
    written: Path
    word: str = ""

    def apply(self, section: Any, name: str) -> Any:
        """Return a section, as plain data, with this change."""
        return put(section, self.path[1:], self.value) if self.path else merge(section, self.value[name])


@dataclass(frozen=True, slots=True)
class Draft:
    """A condition before it is checked; ``home`` is the path in the file that brings it about."""

    changes: tuple[_Change, ...]
    home: Path
    name: str | None = None

    @property
    def id(self) -> str:
        """The id that the condition has or will have."""
        return self.name or _product_id([change.word for change in self.changes])


MAX_FAULTS = 20
"""Places at fault in a grid, after which no more are looked for."""

_expanded: Beside[tuple[Condition, ...]] = Beside()


def expand(config: SweepConfig) -> tuple[Condition, ...]:
    """Return the conditions of a study: the product of ``sweep`` in the order written, then the named ones.

    The ids do not change when values are added to a list or conditions to the study. A configuration is laid out once;
    after that the same tuple is returned. Conditions share the objects of the sections that none of them changes.

    Raises
    ------
    ConfigError
        If a condition is invalid; a configuration from ``load_config`` has none.
    """
    conditions = _expanded.of(config)
    if conditions is not None:
        return conditions
    conditions, faults = expand_and_check(config)
    if faults:
        raise ConfigError(faults[0].message, Place(None), dotted(faults[0].paths[0]))
    return conditions


def expand_and_check(config: SweepConfig) -> tuple[tuple[Condition, ...], list[Problem]]:
    """Return the valid conditions, and the faults of the others, at most `MAX_FAULTS`, with their paths in the file."""
    grid = _Grid(config.parameters)
    faults: dict[Path, Problem] = {}
    for draft in drafts(config):
        for fault in grid.add(draft):
            faults.setdefault(fault.paths[0], fault)
        if len(faults) >= MAX_FAULTS:
            break
    conditions = tuple(grid.conditions)
    if not faults:
        _expanded.keep(config, conditions)
    return conditions, list(faults.values())


class _Part(NamedTuple):
    """A section of a condition and its number; equal sections have one number."""

    section: Any
    number: int


_Work = tuple[str, tuple[_Change, ...]]
"""The name of a section, and the changes made to it."""


class _Grid:
    """The conditions found so far.

    Only the sections that a draft changes are checked; the others are the base's. A section that several drafts of a
    product change alike is made once. This is what keeps ten thousand conditions of a robot of thousands of nodes
    affordable, in time and in memory.
    """

    def __init__(self, base: Parameters):
        self.conditions: list[Condition] = []
        self.base, self.plain = base, base.model_dump()
        self.numbers: dict[Any, int] = {}
        self.base_numbers = {name: self._part(section).number for name, section in base}
        self.made: dict[_Work, _Part | None] = {}
        self.told: set[tuple[_Work, ...]] = set()
        self.ids: set[str] = set()
        self.known: dict[tuple[int, ...], str] = {}

    def add(self, draft: Draft) -> list[Problem]:
        """Add the condition of a draft, if it is valid, and return what is wrong with it and was not told before."""
        parts, faulty = self._parts(draft)
        if faulty in self.told:
            return []
        if faulty:
            self.told.add(faulty)
            return _faults(draft, self.plain)
        try:
            parameters = self.base.changed({name: part.section for name, part in parts.items()})
        except PydanticCustomError:
            return _faults(draft, self.plain)
        condition = Condition(draft.id, parameters)
        self.conditions.append(condition)
        numbers = self.base_numbers | {name: part.number for name, part in parts.items()}
        return self._twins(condition.id, tuple(numbers.values()), draft.home)

    def _parts(self, draft: Draft) -> tuple[dict[str, _Part], tuple[_Work, ...]]:
        """Make the sections that a draft changes; return those, and what came to nothing."""
        made = {work: self._made(*work) for work in _by_section(draft.changes).items()}
        return {name: part for (name, _), part in made.items() if part}, tuple(
            w for w, part in made.items() if not part
        )

    def _made(self, name: str, changes: tuple[_Change, ...]) -> _Part | None:
        if (name, changes) not in self.made:
            try:
                value = self.plain[name]
                for change in changes:
                    value = change.apply(value, name)
                part = self._part(_adapter(name).validate_python(value))
            except (LookupError, ValidationError):
                part = None
            self.made[name, changes] = part
        return self.made[name, changes]

    def _part(self, section: Any) -> _Part:
        return _Part(section, self.numbers.setdefault(section, len(self.numbers)))

    def _twins(self, condition: str, numbers: tuple[int, ...], home: Path) -> list[Problem]:
        """Refuse a condition whose id or parameters came before; some file systems ignore the case of names."""
        twin = self.known.setdefault(numbers, condition)
        folded = condition.lower()
        if folded in self.ids:
            return [Problem((home,), f"the condition {condition} exists twice; rename one")]
        self.ids.add(folded)
        if twin != condition:
            return [Problem((home,), f"the condition {condition} is the same as {twin}; change or remove one")]
        return []


def _by_section(changes: tuple[_Change, ...]) -> dict[str, tuple[_Change, ...]]:
    """Return the changes made to each section; those of a named condition are one change to several."""
    sections: dict[str, tuple[_Change, ...]] = {}
    for change in changes:
        for name in change.path[:1] or change.value:
            sections[name] = (*sections.get(name, ()), change)
    return sections


@lru_cache
def _adapter(name: str) -> TypeAdapter[Any]:
    field = Parameters.model_fields[name]
    return TypeAdapter(Annotated[field.annotation, field])  # pyright: ignore[reportInvalidTypeForm, reportArgumentType]


def _faults(draft: Draft, base: dict[str, Any]) -> list[Problem]:
    """Check the parameters of a draft as a whole: only so do the errors know the places of what is at fault."""
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
        Parameters.model_validate(data)
    except ValidationError as error:
        return [_as_written(problem, draft) for problem in problems(error, data, Parameters)]
    raise AssertionError(f"condition {draft.id}: its parts are at fault, and the whole is not")


def drafts(config: SweepConfig) -> Iterator[Draft]:
    """Yield what the conditions of a study are made of."""
    if not config.sweep and not config.conditions:
        yield Draft((), ("name",), config.name)
    if config.sweep:
        labels = _labels(config.sweep)
        changes = [
            [
                _Change(split_key(key), value, ("sweep", key, i), _short(f"{label}-{_word(value)}"))
                for i, value in enumerate(values)
            ]
            for label, (key, values) in zip(labels, config.sweep.items(), strict=True)
        ]
        for chosen in itertools.product(*changes):
            yield Draft(chosen, ("sweep",))
    for name, overrides in config.conditions.items():
        home = ("conditions", name)
        yield Draft((_Change((), overrides, home),), home, name)


def _as_written(problem: Problem, draft: Draft) -> Problem:
    """Point a fault of a condition at the place in the file that brought it about."""
    found = [written for path in problem.paths for written in [_written(path, draft, problem.about_key)] if written]
    closeness, path = max(found, key=lambda pair: pair[0], default=(0, problem.paths[0]))
    if path[0] == "conditions" or problem.about_key:
        return Problem((path,), problem.message, problem.about_key)
    what = "" if closeness == 2 else f"{dotted(problem.paths[0])} "
    return Problem((path,), f"{what}{problem.message} (in condition {draft.id})")


def _written(path: Path, draft: Draft, about_key: bool) -> tuple[int, Path] | None:
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


def fault_of(
    config: SweepConfig, condition: str, message: str, keys: Sequence[str], document: Container[Path]
) -> Problem:
    """Return the fault of a condition that was found after all its settings had been checked.

    It is placed at the first of the dotted ``keys`` that the condition itself gives or that was written in the document
    for all conditions.
    """
    draft = next((draft for draft in drafts(config) if draft.id == condition), Draft((), ("name",), condition))
    paths: list[Path] = [tuple(int(part) if part.isdecimal() else part for part in split_key(key)) for key in keys]
    where = f" (in condition {condition})" if draft.changes else ""
    for path in paths:
        if (_written(path, draft, about_key=False) or (0,))[0] == 2:
            return _as_written(Problem((path,), message), draft)
        if path in document:
            return Problem((path,), f"{message}{where}")
    return Problem((paths[0],), f"{message}{where}")


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


def _short(word: str) -> str:
    """Replace the end of a very long word by a digest: thousands of ids may hold the list of all nodes of a robot."""
    return word if len(word) <= 2 * MAX_NAME else f"{word[:MAX_NAME]}-{hashlib.sha256(word.encode()).hexdigest()[:10]}"


def _product_id(words: list[str]) -> str:
    joined = "_".join(words)
    written = re.sub(r"[^A-Za-z0-9._-]", "-", joined)
    if len(written) <= MAX_NAME:
        return written
    digest = hashlib.sha256(joined.encode()).hexdigest()[:10]
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
    flat = {key: _value(parameters, path) for key, path in _leaves()}
    gravity = flat.pop("scene.gravity")
    flat["scene.gravity.x"], flat["scene.gravity.y"] = gravity if isinstance(gravity, tuple) else (0.0, -gravity)
    if flat["wobble.dimension"] is not None:
        flat["wobble.dimension"] = "+".join(flat["wobble.dimension"])
    return flat | _custom_columns(parameters.robot)


def _value(section: Any, path: tuple[str, ...]) -> Any:
    for key in path:
        section = None if section is None else vars(section).get(key)
    return section


@lru_cache
def _leaves() -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Dotted key and path of every value; of the robots, those of the starfish."""
    return tuple((".".join(path), path) for path in _paths(Parameters))


def _paths(model: type[Section]) -> Iterator[tuple[str, ...]]:
    for key, field in model.model_fields.items():
        inner = [kind for kind in models_in(field.annotation) if kind is not CustomRobot]
        for path in _paths(inner[0]) if inner else [()]:
            yield key, *path


@lru_cache(maxsize=64)
def _custom_columns(robot: StarfishRobot | CustomRobot) -> dict[str, str | int | None]:
    if isinstance(robot, StarfishRobot):
        return dict.fromkeys(("robot.nodes", "robot.springs", "robot.muscles", "robot.digest"))
    digest = hashlib.sha256(robot.model_dump_json().encode()).hexdigest()[:16]
    counts = {"robot.nodes": len(robot.nodes), "robot.springs": len(robot.springs), "robot.muscles": len(robot.muscles)}
    return {**counts, "robot.digest": digest}
