"""The JSON Schema of a configuration, by which editors complete and check one while it is written."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from wobblesim.config.errors import SWEEP_ONLY
from wobblesim.config.fields import NAME_IN_SCHEMA
from wobblesim.config.schema import Parameters, SweepConfig

LISTED = ("Node", "Spring", "Muscle")
"""Parts of a robot, which stand in lists; a condition gives a list as a whole."""


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a configuration file, for editors.

    It knows what a swept key takes and what a condition may change; rules between keys are left to `parse_config`.
    """
    schema = SweepConfig.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "wobblesim configuration"
    properties = schema["properties"]
    loose = {f"{name}Changes": _loose(section) for name, section in schema["$defs"].items() if name not in LISTED}
    changes = _loose({"type": "object", "properties": {name: properties[name] for name in Parameters.model_fields}})
    properties["sweep"]["properties"] = dict(_swept(schema, schema["$defs"]))
    properties["conditions"] |= {
        "propertyNames": NAME_IN_SCHEMA,
        "additionalProperties": {"anyOf": [changes | {"additionalProperties": False}, {"type": "null"}]},
    }
    properties["conditions"].pop("patternProperties")
    schema["$defs"] |= loose
    return dict(sorted(schema.items(), key=lambda item: item[0] == "$defs"))


def _swept(section: dict[str, Any], sections: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the dotted key and the list of values of everything in a section that can be swept."""
    for key, described in section["properties"].items():
        homes = [home for home in _references(described) if home not in LISTED]
        for home in homes:
            yield from _swept(sections[home], sections, f"{prefix}{key}.")
        if homes or (not prefix and key in SWEEP_ONLY) or "const" in described:
            continue
        value = {name: part for name, part in described.items() if name not in ("title", "default", "description")}
        yield (
            f"{prefix}{key}",
            {"type": "array", "minItems": 1, "description": described["description"], "items": value},
        )


def _references(described: dict[str, Any]) -> list[str]:
    """Return the names of the sections that a key can hold."""
    choices = [described, *described.get("anyOf", ()), *described.get("oneOf", ())]
    return [choice["$ref"].rpartition("/")[2] for choice in choices if "$ref" in choice]


def _loose(described: Any) -> Any:
    """Return a schema in which no key is required and nothing has a default: that of changes to a section."""
    if isinstance(described, list):
        return [_loose(item) for item in described]
    if not isinstance(described, dict):
        return described
    kept = {
        key: _loose(value) for key, value in described.items() if key not in ("required", "default", "discriminator")
    }
    if "oneOf" in kept:
        kept["anyOf"] = kept.pop("oneOf")
    if "$ref" in kept and not kept["$ref"].endswith(LISTED):
        kept["$ref"] += "Changes"
    return kept
