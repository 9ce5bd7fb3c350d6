"""The error of a bad configuration, and the sentences that pydantic's errors become.

Every error reads ``FILE:LINE:COL: KEY: what is wrong; what is allowed (did you mean ...?)`` on one line.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pydantic import ValidationError

from wobblesim.config.fields import MAX_NAME, Path, shown
from wobblesim.config.lookup import allowed, choices_in, field_at, keys_at, leaf_paths
from wobblesim.config.schema import MAX_EPOCHS, Parameters, Section, SweepConfig

ROBOT_KINDS = ("starfish", "custom")
SWEEP_ONLY = ("name", "seeds", "sweep", "conditions")
MAX_TRANSLATED = 200
"""Errors of a file that are put into words; a file with tens of thousands is answered as soon as one with a few."""


@dataclass(frozen=True)
class Place:
    """Where something was written: a file (or an option such as ``--set a.b=v``), a line and a column from 1."""

    path: str | None
    line: int | None = None
    column: int | None = None


class ConfigError(Exception):
    """A configuration that cannot be used.

    Attributes
    ----------
    path : str or None
        File, ``<stdin>``, or the option that carried the value, such as ``--set physics.dt=0``.
    line, column : int or None
        Place in the file, both from 1.
    key : str
        Dotted key, empty where the file as a whole is at fault.
    message : str
        What is wrong and what is allowed.
    others : tuple of ConfigError
        The remaining errors of the same file, the most useful first.
    """

    def __init__(self, message: str, place: Place = Place(None), key: str = "", others: Sequence[ConfigError] = ()):
        super().__init__(message)
        self.path, self.line, self.column = place.path, place.line, place.column
        self.key = one_line(key)
        self.message = one_line(message)
        self.others = tuple(others)

    def __str__(self) -> str:
        marks = [one_line(self.path) if self.path else None, self.line, self.column]
        where = ":".join(str(mark) for mark in marks if mark is not None)
        key = self.key if len(self.key) <= MAX_NAME else f"{self.key[:MAX_NAME]}..."
        return ": ".join(part for part in (where, key, self.message) if part)

    def report(self) -> str:
        """All errors of the file, one line each."""
        return "\n".join(str(error) for error in (self, *self.others))


@dataclass(frozen=True)
class Problem:
    """One fault of a configuration, before it has a place.

    Attributes
    ----------
    paths : tuple of Path
        The values at fault, the likeliest first.
    message : str
        The sentence.
    about_key : bool
        Whether the key is at fault, and not its value.
    meant : str or None
        The key that an unknown key probably stands for.
    """

    paths: tuple[Path, ...]
    message: str
    about_key: bool = False
    meant: str | None = None

    @property
    def is_missing(self) -> bool:
        """Whether a key is missing."""
        return self.message.startswith("is missing")


def one_line(words: str) -> str:
    """Escape whatever would break a line or hide text on a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in words)


def dotted(path: Path) -> str:
    """Write a path as a key: ``robot.nodes[0].mass``."""
    written = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return written.removeprefix(".")


def problems(error: ValidationError, data: Mapping[str, Any], root: type[Section] = SweepConfig) -> list[Problem]:
    """Translate pydantic's errors, the most useful first: unknown keys, then bad values, then missing keys.

    A key that is missing because it was misspelt is reported once, as the misspelling, and a list or mapping that is
    at fault because of something in it is not reported.
    """
    details = error.errors(include_url=False)
    if len(details) > MAX_TRANSLATED:
        details = sorted(details, key=lambda one: one["type"] != "extra_forbidden")[:MAX_TRANSLATED]
    found = [_problem(one, data, root) for one in details]
    meant = {(*problem.paths[0][:-1], problem.meant) for problem in found if problem.meant}
    inner = {problem.paths[0][:n] for problem in found for n in range(len(problem.paths[0]))}
    kept = [p for p in found if not (p.paths[0] in inner or (p.is_missing and p.paths[0] in meant))]
    return sorted(kept or found, key=lambda p: (not p.about_key, p.is_missing))


def _problem(details: Any, data: Mapping[str, Any], root: type[Section]) -> Problem:
    path = _data_path(details["loc"], data)
    kind, value = details["type"], details["input"]
    if kind == "refused":
        return Problem(tuple((*path, *at) for at in details["ctx"]["at"]) or (path,), details["ctx"]["message"])
    if kind == "extra_forbidden":
        return unknown_key(path, data, root)
    if kind == "missing" and isinstance(path[-1], int):
        path = path[:-1]
    elif kind == "missing":
        return Problem((path,), f"is missing; {_remedy(path, root)}")
    if kind in ("union_tag_not_found", "union_tag_invalid") and isinstance(value, Mapping):
        return _bad_kind((*path, "kind"), value)
    hint = did_you_mean(value, _choices(path, root)) if kind == "literal_error" else _cost(path, value, data)
    return Problem((path,), f"{_fault(kind, value)}; {_remedy(path, root)}{hint}")


def _cost(path: Path, value: Any, data: Mapping[str, Any]) -> str:
    """Say what far too many epochs would cost; nothing where something else of the configuration is at fault too."""
    if path != ("learning", "epochs") or not isinstance(value, int | float) or not MAX_EPOCHS < value < 1e15:
        return ""
    try:
        config = SweepConfig.model_validate({**data, "learning": {**data["learning"], "epochs": MAX_EPOCHS}})
    except ValidationError:
        return ""
    return f" ({config.cost(int(value))})"


def _data_path(loc: Path, data: Any) -> Path:
    """Leave out what pydantic adds: the robot's kind after ``robot``, ``[key]`` marks, and what leads into a scalar."""
    if len(loc) > 1 and loc[0] == "robot" and loc[1] in ROBOT_KINDS:
        loc = (loc[0], *loc[2:])
    path: Path = ()
    for part in loc:
        if not isinstance(data, Mapping | list | tuple):
            break
        if part != "[key]":
            path = (*path, part)
            data = value_at(data, (part,))
    return path


def _bad_kind(path: Path, robot: Mapping[str, Any]) -> Problem:
    if "kind" in robot:
        wrong = f"{shown(robot['kind'])} is not a kind of robot"
        return Problem((path,), f"{wrong}; allowed: starfish or custom{did_you_mean(robot['kind'], ROBOT_KINDS)}")
    near = difflib.get_close_matches("kind", [str(key) for key in robot], 1)
    if near:
        return Problem(((*path[:-1], near[0]),), "unknown key (did you mean 'kind'?)", True, "kind")
    return Problem((path,), "is missing; allowed: starfish or custom")


def _not_whole(value: Any) -> str:
    is_whole = isinstance(value, float) and value.is_integer() and abs(value) < 1e15
    return (
        f"has a point or an exponent; a whole number is written {int(value)}" if is_whole else "is not a whole number"
    )


FAULTS: dict[str, Callable[[Any], str]] = {
    "float_type": lambda value: "is not a number",
    "int_type": _not_whole,
    "int_from_float": _not_whole,
    "finite_number": lambda value: "is not finite",
    "bool_type": lambda value: "is not true or false",
    "string_type": lambda value: "is not text" + (" (put it in quotes)" if isinstance(value, int | float) else ""),
    "tuple_type": lambda value: "is not a list",
    "dict_type": lambda value: "is not a mapping",
    "model_type": lambda value: "is not a mapping",
    "model_attributes_type": lambda value: "is not a mapping",
    "literal_error": lambda value: "is not a choice",
    "greater_than": lambda value: "is too small",
    "greater_than_equal": lambda value: "is too small",
    "less_than": lambda value: "is too large",
    "less_than_equal": lambda value: "is too large",
    "missing": lambda value: "is too short",
    "too_short": lambda value: "is too short",
    "too_long": lambda value: "is too long",
}


def _fault(kind: str, value: Any) -> str:
    describe = FAULTS.get(kind, lambda value: "is not allowed")
    return f"{shown(value)} {describe(value)}"


def _remedy(path: Path, root: type[Section]) -> str:
    if len(path) == 2 and path[0] == "sweep":
        return f"allowed: a list of values under a dotted key, such as {path[1]}: [...] or wobble.period: [25, 50]"
    if len(path) == 2 and path[0] == "conditions":
        return "allowed: a mapping of changes such as {wobble: null}"
    field = field_at(path, root)
    return f"allowed: {allowed(field)}" if field else "see the schema"


def _choices(path: Path, root: type[Section]) -> Sequence[str]:
    field = field_at(path, root)
    return choices_in(field.annotation) if field else ()


def did_you_mean(word: Any, choices: Sequence[str]) -> str:
    """Return `` (did you mean 'x'?)``, or nothing where no choice is near."""
    near = nearest(word, choices)
    return f" (did you mean '{near}'?)" if near else ""


def nearest(word: Any, choices: Sequence[str], cutoff: float = 0.55) -> str | None:
    """Return the choice most like a word, or None."""
    if not isinstance(word, str):
        return None
    if len(word) <= 3:  # one wrong letter of two leaves a likeness of 0.5
        cutoff = min(cutoff, 0.5)
    spelt = {choice.lower(): choice for choice in choices}
    near = difflib.get_close_matches(word.lower().replace("-", "_"), list(spelt), 1, cutoff)
    return spelt[near[0]] if near else None


def unknown_key(path: Path, data: Mapping[str, Any], root: type[Section] = SweepConfig) -> Problem:
    """Describe a key that does not exist, with the nearest that does: in its mapping first, then elsewhere."""
    key, here = str(path[-1]), path[:-1]
    kind = value_at(data, ("robot", "kind"))
    keys = keys_at(here, kind, root)
    if root is not SweepConfig and not here and key in SWEEP_ONLY:
        return Problem(
            (path,), f"unknown key; {key} is the same for all conditions, and belongs at the top level", True
        )
    if here and (*here, key) in _known_paths():
        return Problem((path,), f"unknown key for a robot of kind {kind}; allowed here: {', '.join(keys)}", True)
    if any(key == other[-1] for other in _known_paths()):
        return Problem((path,), f"unknown key; {_elsewhere(key)}", True)
    if tuple(key.split(".")) in _known_paths():
        nested = key.replace(".", ": {", 1).replace(".", ": {")
        return Problem((path,), f"unknown key; write it nested, as {nested}: ...{'}' * key.count('.')}", True)
    meant = nearest(key, keys)
    if meant:
        return Problem((path,), f"unknown key (did you mean '{meant}'?)", True, meant)
    near = nearest(key, tuple(dict.fromkeys(other[-1] for other in _known_paths())), cutoff=0.8)
    hint = f" (did you mean '{near}'? {_elsewhere(near)})" if near else ""
    return Problem((path,), f"unknown key; allowed here: {', '.join(keys)}{hint}", True)


@lru_cache
def _known_paths() -> tuple[tuple[str, ...], ...]:
    return (*((key,) for key in SWEEP_ONLY), *leaf_paths(Parameters))


def _elsewhere(key: str) -> str:
    """Say where a key that exists belongs."""
    homes = [path for path in _known_paths() if path[-1] == key]
    sections = [".".join(home[:-1]) for home in homes]
    if sections == [""]:
        return f"{key} belongs at the top level"
    return f"{key} belongs under {' or '.join(section or 'the top level' for section in sections)}"


def value_at(data: Any, path: Path) -> Any:
    """Return the value at a path of nested data, or None where there is none."""
    for part in path:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data
