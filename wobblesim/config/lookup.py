"""Questions about the schema: which keys are allowed where, and what a key accepts."""

from __future__ import annotations

from typing import Any

from pydantic.fields import FieldInfo

from wobblesim.config.fields import Path, range_text
from wobblesim.config.schema import Parameters, Section, SweepConfig


def models_in(annotation: Any) -> tuple[type[Section], ...]:
    """Return the sections that a field can hold, also inside lists, unions and ``Annotated``."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return (annotation,)
    arguments = getattr(annotation, "__args__", ())
    return tuple(model for argument in arguments for model in models_in(argument))


def choices_in(annotation: Any) -> tuple[str, ...]:
    """Return the words that a field accepts."""
    arguments = getattr(annotation, "__args__", ())
    return tuple(c for a in arguments for c in ((a,) if isinstance(a, str) else choices_in(a)))


def field_at(path: Path, root: type[Section] | None = None) -> FieldInfo | None:
    """Return the field that a path leads to (list positions in the path are passed over), or None."""
    models, field = (root or SweepConfig,), None
    for part in path:
        if isinstance(part, str) and not part.isdigit():
            field = next((m.model_fields[part] for m in models if part in m.model_fields), None)
            if field is None:
                return None
            models = models_in(field.annotation)
    return field


def keys_at(path: Path, kind: str | None = None, root: type[Section] | None = None) -> tuple[str, ...]:
    """Return the keys allowed in the mapping at a path; ``kind`` picks the robot."""
    field = field_at(path, root) if path else None
    models = models_in(field.annotation) if field else (root or SweepConfig,) if not path else ()
    if kind and len(models) > 1:
        models = tuple(m for m in models if kind in choices_in(m.model_fields["kind"].annotation)) or models
    return tuple(dict.fromkeys(key for model in models for key in model.model_fields))


def leaf_paths(root: type[Section] = Parameters, prefix: tuple[str, ...] = ()) -> tuple[tuple[str, ...], ...]:
    """Return the path of every key below a section, list positions left out, sections before their keys."""
    paths: dict[tuple[str, ...], None] = {}
    for key, field in root.model_fields.items():
        paths[*prefix, key] = None
        for model in models_in(field.annotation):
            paths.update(dict.fromkeys(leaf_paths(model, (*prefix, key))))
    return tuple(paths)


def allowed(field: FieldInfo) -> str:
    """Say in words what a field accepts, with its unit."""
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    if "x-allowed" in extra:
        return str(extra["x-allowed"])
    arguments = getattr(field.annotation, "__args__", ())
    null = " or null" if type(None) in arguments else ""
    if "x-unit" in extra:
        return _allowed_number(field, str(extra["x-unit"])) + null
    models = models_in(field.annotation)
    if models:
        keys = ", ".join(dict.fromkeys(key for model in models for key in model.model_fields))
        return f"{'null or ' if null else ''}a mapping with keys among {keys}"
    if field.annotation is bool:
        return "true or false"
    return _either(choices_in(field.annotation))


def _either(choices: tuple[str, ...]) -> str:
    """Join words: ``a, b or c``."""
    return " or ".join(filter(None, (", ".join(choices[:-1]), choices[-1])))


def _allowed_number(field: FieldInfo, unit: str) -> str:
    limits = dict.fromkeys(("gt", "ge", "lt", "le"))
    for constraint in field.metadata:
        limits.update({name: getattr(constraint, name) for name in limits if hasattr(constraint, name)})
    kind = "a whole number" if "int" in str(field.annotation) else "a number"
    return f"{kind} {range_text(**limits)}{f' ({unit})' if unit else ''}"
