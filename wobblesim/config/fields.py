"""The kinds of value a configuration is made of: numbers with ranges, names, seeds.

Each kind knows how to say what it allows, because that sentence is the remedy of every error message.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer
from pydantic_core import PydanticCustomError

MAX_RUNS = 1_000_000
MAX_SEED = 2**63 - 1
MAX_NAME = 80

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
Vector = tuple[Real, Real]
Path = tuple[str | int, ...]


def refusal(message: str, *at: Path) -> PydanticCustomError:
    """Build the error for a broken rule.

    Parameters
    ----------
    message
        One sentence with its remedy.
    *at
        Paths, relative to the model, of the values that break the rule, the likeliest culprit first.
    """
    return PydanticCustomError("refused", "{message}", {"message": message, "at": at})


def range_text(*, gt: float | None, ge: float | None, lt: float | None, le: float | None) -> str:
    """Say a range in words, such as ``above 0 and at most 1``."""
    words = [("above", gt), ("at least", ge), ("below", lt), ("at most", le)]
    return " and ".join(f"{word} {bound:,.12g}" for word, bound in words if bound is not None)


def number(
    default: Any,
    about: str,
    unit: str = "",
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """Declare a numeric field; the description is written from the meaning, the unit and the range."""
    limits = range_text(gt=gt, ge=ge, lt=lt, le=le)
    described = f"{about}{f', in {unit}' if unit else ''}; {limits}."
    return Field(default, gt=gt, ge=ge, lt=lt, le=le, description=described, json_schema_extra={"x-unit": unit})


def text(default: Any, about: str, allowed: str, **limits: Any) -> Any:
    """Declare a field whose allowed values are best said in words."""
    return Field(default, description=f"{about}; {allowed}.", json_schema_extra={"x-allowed": allowed}, **limits)


def first_double(values: Iterable[Any]) -> int | None:
    """Return the position of the first value that came before (True and 1 are different values), or None."""
    seen: set[tuple[bool, Any]] = set()
    for i, value in enumerate(values):
        key = isinstance(value, bool), value
        if key in seen:
            return i
        seen.add(key)
    return None


def shown(value: Any) -> str:
    """Show a value in a message as YAML would write it: one line, at most 40 characters."""
    names = {None: "null", True: "true", False: "false"}
    is_named = value is None or isinstance(value, bool)
    if isinstance(value, dict | list | tuple):
        kind = "mapping" if isinstance(value, dict) else "list"
        return f"a {kind} of {len(value)}" if value else f"an empty {kind}"
    written = names[value] if is_named else ascii(value) if isinstance(value, str) else f"{value!r}"
    return written if len(written) <= 40 else f"{written[:25]}... ({len(written)} characters)"


def _check_name(name: str) -> str:
    if not SAFE_NAME.fullmatch(name) or name.partition(".")[0].upper() in DEVICE_NAMES:
        raise refusal(f"{shown(name)} cannot name a file; allowed: {NAME_RULE}")
    return name


NAME_RULE = "1 to 80 of A-Z a-z 0-9 . _ -, the first a letter or digit, the last no dot, no device name such as CON"
SAFE_NAME = re.compile(rf"(?=.{{1,{MAX_NAME}}}\Z)[A-Za-z0-9](?:[A-Za-z0-9._-]*[A-Za-z0-9_-])?")
# Windows opens a device, not a file, under these names, whatever the extension.
DEVICE_NAMES = {"CON", "PRN", "AUX", "NUL", *(f"{port}{n}" for port in ("COM", "LPT") for n in range(10))}
Name = Annotated[str, Field(strict=True), AfterValidator(_check_name)]

SEED_RULE = "a whole number from 0, a list such as [0, 3, 7], or a range such as 0..99 (both ends included)"


def _seeds(value: Any) -> tuple[int, ...]:
    """Turn a number, a list or a range into distinct seeds, in the order given."""
    spans = [_seed_span(item) for item in _seed_items(value)]
    count = sum(last - first + 1 for first, last in spans)
    if not 1 <= count <= MAX_RUNS:
        raise refusal(f"gives {count:,} seeds; allowed: 1 to {MAX_RUNS:,}")
    seeds = tuple(seed for first, last in spans for seed in range(first, last + 1))
    double = first_double(seeds)
    if double is not None:
        raise refusal(f"seed {seeds[double]} is listed twice; list each seed once")
    return seeds


def _seed_items(value: Any) -> list[Any]:
    if isinstance(value, str):
        return [item.strip() for item in value.split(",")]
    return list(value) if isinstance(value, list | tuple) else [value]


def _seed_span(item: Any) -> tuple[int, int]:
    """First and last seed of one item: a number or ``first..last``."""
    match = re.fullmatch(r"([0-9]{1,19})(?:\.\.([0-9]{1,19}))?", item, re.ASCII) if isinstance(item, str) else None
    if match:
        first, last = int(match[1]), int(match[2] or match[1])
    elif isinstance(item, int) and not isinstance(item, bool):
        first = last = item
    else:
        raise refusal(f"{shown(item)} is not a seed; allowed: {SEED_RULE}")
    if last < first:
        raise refusal(f"the range {first}..{last} is empty; write the smaller seed first")
    if first < 0 or last > MAX_SEED:
        raise refusal(f"seed {first if first < 0 else last} is out of range; allowed: 0 to {MAX_SEED}")
    return first, last


def _written_seeds(seeds: tuple[int, ...]) -> str | list[int]:
    """The shortest way to write seeds that reads back to the same."""
    first, count = min(seeds), len(seeds)
    is_range = count > 2 and seeds == tuple(range(first, first + count))
    return f"{first}..{first + count - 1}" if is_range else list(seeds)


SeedItem = int | str
Seeds = Annotated[
    tuple[int, ...],
    BeforeValidator(_seeds, json_schema_input_type=SeedItem | list[SeedItem]),
    PlainSerializer(_written_seeds, return_type=str | list[int]),
]


def _frozen(value: Any) -> Any:
    """Replace lists by tuples, at any depth."""
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def _override(value: Any) -> Any:
    """A condition without overrides may be left empty in YAML."""
    return {} if value is None else value


Override = Annotated[
    dict[str, Any], AfterValidator(_frozen), BeforeValidator(_override, json_schema_input_type=dict[str, Any] | None)
]
Values = Annotated[tuple[Any, ...], AfterValidator(_frozen)]
