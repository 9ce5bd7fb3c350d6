"""The kinds of value a configuration is made of: numbers with ranges, names, seeds.

Each kind knows how to say what it allows, because that sentence is the remedy of every error message.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import pairwise
from operator import eq
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
    seen: set[Any] = set()
    for i, value in enumerate(values):
        key = _hashable(value)
        if key in seen:
            return i
        seen.add(key)
    return None


def _hashable(value: Any) -> Any:
    if isinstance(value, dict):
        return frozenset((key, _hashable(item)) for key, item in value.items())
    return tuple(map(_hashable, value)) if isinstance(value, list | tuple) else (isinstance(value, bool), value)


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
NAME_IN_SCHEMA = {"minLength": 1, "maxLength": MAX_NAME, "pattern": "^[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9_-])?$"}
Name = Annotated[str, Field(strict=True, json_schema_extra=NAME_IN_SCHEMA), AfterValidator(_check_name)]

# Results lie in folders condition=<id>. Where all ids of a study look like that, pyarrow and pandas take whole numbers
# (0x1f is one) for numbers, and DuckDB dates, 0b1, inf and epoch too: tried with pyarrow 26.0, pandas 3.1, DuckDB 2.0.
NOT_TEXT = re.compile(r"[0-9]+|0[xX][0-9a-fA-F]+|0[bB][01]+|[0-9]+-[0-9]+-[0-9]+|(?i:inf|infinity|epoch)")


def check_id(name: str, *at: Path) -> None:
    """Refuse the id of a condition that readers of the results would not take for text."""
    if NOT_TEXT.fullmatch(name):
        raise refusal(
            f"{shown(name)} cannot be the id of a condition, which programs that read the results would take for a "
            f"number or a date; write a word before it, such as run-{name}",
            *at,
        )


SEED_RULE = "a whole number from 0, a list such as [0, 3, 7], or a range such as 0..99 (both ends included)"


def _seeds(value: Any) -> tuple[int, ...]:
    """Turn a number, a list or a range into distinct seeds, in the order given."""
    spans = [_seed_span(item) for item in _seed_items(value)]
    count = sum(last - first + 1 for first, last in spans)
    if not 1 <= count <= MAX_RUNS:
        raise refusal(f"gives {count:,} seeds; allowed: 1 to {MAX_RUNS:,}")
    for (_, last), (first, _) in pairwise(sorted(spans)):
        if first <= last:
            raise refusal(f"seed {first} is listed twice; list each seed once")
    return tuple(seed for first, last in spans for seed in range(first, last + 1))


def _seed_items(value: Any) -> list[Any]:
    if isinstance(value, str):
        return [item.strip() for item in value.split(",")]
    return list(value) if isinstance(value, list | tuple) else [value]


def _seed_span(item: Any) -> tuple[int, int]:
    """First and last seed of one item: a number or ``first..last``."""
    if isinstance(item, str) and re.fullmatch(SPAN, item):
        start, _, end = item.partition("..")
        first, last = int(start), int(end or start)
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
    is_range = count > 2 and all(map(eq, seeds, range(first, first + count)))
    return f"{first}..{first + count - 1}" if is_range else list(seeds)


SPAN = r"[0-9]{1,19}(\.\.[0-9]{1,19})?"
Number = Annotated[int, Field(ge=0, le=MAX_SEED)]
SeedItem = Number | Annotated[str, Field(pattern=f"^{SPAN}$")]
SeedText = Annotated[str, Field(pattern=f"^ *{SPAN} *(, *{SPAN} *)*$")]
SeedList = Annotated[list[SeedItem], Field(min_length=1)]
Seeds = Annotated[
    tuple[int, ...],
    BeforeValidator(_seeds, json_schema_input_type=Number | SeedText | SeedList),
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
