"""Configurations drawn from the JSON Schema that editors are given."""

from __future__ import annotations

import re
from typing import Any

from hypothesis import strategies as st

from wobblesim.config import json_schema
from wobblesim.config.fields import NAME_IN_SCHEMA

SCHEMA = json_schema()
WORDS = [
    "name",
    "kind",
    "custom",
    "wobble",
    "wobble.period",
    "physics.dt",
    "log",
    "no",
    "010",
    "1e-3",
    "0..3",
    "",
    "../x",
]
RUBBISH = st.one_of(
    st.sampled_from(WORDS),
    st.integers(),
    st.floats(),
    st.booleans(),
    st.none(),
    st.text(max_size=5),
    st.lists(st.integers(-1, 3), max_size=3),
    st.dictionaries(st.sampled_from(WORDS), st.integers(-1, 3), max_size=2),
)


def configurations(rubbish: bool = False) -> st.SearchStrategy[dict[str, Any]]:
    """What the schema allows, with things it does not allow here and there if asked for."""
    return _drawn(SCHEMA, rubbish)


def _drawn(schema: dict[str, Any], rubbish: bool) -> st.SearchStrategy[Any]:
    meant = _meant(schema, rubbish)
    return st.integers(0, 29).flatmap(lambda die: meant if die else RUBBISH) if rubbish else meant


def _meant(schema: dict[str, Any], rubbish: bool) -> st.SearchStrategy[Any]:
    choices = schema.get("anyOf") or schema.get("oneOf")
    if "$ref" in schema:
        return st.deferred(lambda: _drawn(SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]], rubbish))
    if "const" in schema or "enum" in schema:
        return st.sampled_from(schema.get("enum") or [schema["const"]])
    if choices:
        return st.one_of(*(_drawn(choice, rubbish) for choice in choices))
    kinds = {"object": _mapping, "array": _list, "integer": _whole, "number": _real, "string": _text}
    simple = {"boolean": st.booleans(), "null": st.none(), None: RUBBISH}
    kind = schema.get("type")
    return kinds[kind](schema, rubbish) if kind in kinds else simple[kind]


def _mapping(schema: dict[str, Any], rubbish: bool) -> st.SearchStrategy[dict[str, Any]]:
    known, required = schema.get("properties", {}), schema.get("required", [])
    if not known:  # named conditions
        names = st.from_regex(schema["propertyNames"]["pattern"], fullmatch=True).map(lambda name: name[:80])
        return st.dictionaries(names, _drawn(schema["additionalProperties"], rubbish), max_size=3)
    drawn = {key: _drawn(known[key], rubbish) for key in known}
    named = st.fixed_dictionaries({key: drawn[key] for key in required})
    others = st.lists(st.sampled_from([key for key in known if key not in required]), unique=True, max_size=4)
    some = others.flatmap(lambda keys: st.fixed_dictionaries({key: drawn[key] for key in keys}))
    misspelt = st.dictionaries(st.sampled_from(WORDS), RUBBISH, max_size=1) if rubbish else st.just({})
    return st.builds(
        lambda *parts: {key: value for part in parts for key, value in part.items()}, misspelt, named, some
    )


def _list(schema: dict[str, Any], rubbish: bool) -> st.SearchStrategy[list[Any]]:
    if "prefixItems" in schema:
        return st.tuples(*(_drawn(item, rubbish) for item in schema["prefixItems"])).map(list)
    least, item = schema.get("minItems", 0), _drawn(schema.get("items", {}), rubbish)
    alike = {"unique": schema.get("uniqueItems", False) and not rubbish}
    return st.lists(item, min_size=least, max_size=max(least, 3), **alike)


def _whole(schema: dict[str, Any], _: bool) -> st.SearchStrategy[int]:
    return st.integers(schema.get("minimum", 0), schema.get("maximum", 2**63 - 1))


def _real(schema: dict[str, Any], _: bool) -> st.SearchStrategy[float]:
    over, under = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    return st.floats(
        over if over is not None else schema.get("minimum", -1e4),
        under if under is not None else schema.get("maximum", 1e4),
        exclude_min=over is not None,
        exclude_max=under is not None,
    )


def _text(schema: dict[str, Any], _: bool) -> st.SearchStrategy[str]:
    if schema["pattern"] == NAME_IN_SCHEMA["pattern"]:
        return st.from_regex(schema["pattern"], fullmatch=True).map(lambda name: name[:80])
    return st.sampled_from(
        [seeds for seeds in ("5", "10..13", "0, 3", "7..9, 6") if re.search(schema["pattern"], seeds)]
    )
