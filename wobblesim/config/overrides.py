"""Changes to a configuration: by path, by nested mapping, and from the command line (``--set``, ``--seeds``)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from wobblesim.config.errors import ConfigError, Place, dotted
from wobblesim.config.fields import Path, shown
from wobblesim.config.reading import MAX_KEY, Document, read_value


def split_key(key: str) -> tuple[str, ...]:
    """Split a dotted key; ``robot.nodes[0].mass`` and ``robot.nodes.0.mass`` are the same."""
    return tuple(re.sub(r"\[([0-9]+)\]", r".\1", key).split("."))


def put(data: Any, path: Path, value: Any) -> Any:
    """Return a copy of nested data with one value replaced; mappings on the way are made where there are none.

    Raises
    ------
    LookupError
        If the path counts beyond the end of a list, or leads into a value that holds no others.
    """
    if not path:
        return value
    key, *rest = path
    if isinstance(data, list | tuple):
        i = _list_index(data, key)
        return [*data[:i], put(data[i], tuple(rest), value), *data[i + 1 :]]
    if data is not None and not isinstance(data, Mapping):
        raise LookupError(f"{shown(data)} is a single value, so there is no {key} in it")
    inner = dict(data or {})
    inner[str(key)] = put(inner.get(str(key)), tuple(rest), value)
    return inner


def _list_index(items: Sequence[Any], key: str | int) -> int:
    i = int(key) if isinstance(key, int) or key.isdecimal() else len(items)
    if i >= len(items):
        raise LookupError(f"there is no item {key}; the list has the items 0 to {len(items) - 1}")
    return i


def merge(base: Any, changes: Any) -> Any:
    """Return nested data with a nested change: mappings are merged, everything else is replaced.

    A robot of another kind replaces the robot as a whole, since the two kinds share no keys.
    """
    is_nested = isinstance(base, Mapping) and isinstance(changes, Mapping)
    if not is_nested or ("kind" in changes and changes["kind"] != base.get("kind")):
        return changes
    merged = {key: merge(base[key], changes[key]) if key in changes else base[key] for key in base}
    return merged | {key: changes[key] for key in changes if key not in base}


def apply_settings(document: Document, settings: Sequence[str]) -> None:
    """Apply ``key=value`` settings to a document, in order; errors in them point at ``--set key=value``.

    The value is YAML; ``key=1,2,3`` is short for ``key=[1, 2, 3]``.

    Raises
    ------
    ConfigError
        If a setting cannot be read, or would have no effect because its key is swept.
    """
    places = [(_apply(document, setting), setting) for setting in settings]
    swept = document.data.get("sweep")
    for path, setting in places:
        for key in swept if isinstance(swept, Mapping) else ():
            inner = split_key(key)
            if inner[: len(path)] == path or path[: len(inner)] == inner:
                raise ConfigError(
                    f"has no effect on {key}, which is swept; set sweep.{key} instead",
                    Place(f"--set {setting}"),
                    dotted(path),
                )


def apply_seeds(document: Document, seeds: str) -> None:
    """Replace the seeds of a document by those of ``--seeds``."""
    document.data["seeds"] = seeds
    document.forget(("seeds",))
    document.values["seeds",] = Place(f"--seeds {seeds}")


def _apply(document: Document, setting: str) -> Path:
    source = f"--set {setting}"
    key, equals, text = setting.partition("=")
    if not equals or not all(split_key(key.strip())):
        raise ConfigError("is not a setting; write key=value, such as physics.dt=0.005", Place(source))
    if len(key) > MAX_KEY:
        raise ConfigError(f"a key of {len(key):,} characters is no key of a configuration", Place(source))
    path = _setting_path(document.data, key.strip())
    if not text.strip():
        raise ConfigError("has no value; write key=value, or key=null for none", Place(source), key)
    value = read_value(_as_yaml(text), source, path)
    try:
        document.data = put(document.data, path, value.data)
    except LookupError as error:
        raise ConfigError(str(error), Place(source), key) from None
    document.forget(path)
    made = {path[:n]: Place(source) for n in range(1, len(path) + 1) if path[:n] not in document.keys}
    document.values.update(value.values)
    document.keys.update(made | value.keys)
    return path


def _as_yaml(text: str) -> str:
    is_list = "," in text and not text.lstrip().startswith(("[", "{", '"', "'"))
    return f"[{text}]" if is_list else text


def _setting_path(data: Mapping[str, Any], key: str) -> Path:
    """Split a key, where the keys of ``sweep`` and the names of conditions may hold dots themselves."""
    section, _, rest = key.partition(".")
    if section == "sweep" and rest:
        return section, rest
    names = data.get("conditions")
    for name in names if section == "conditions" and isinstance(names, Mapping) else ():
        if rest == name or rest.startswith(f"{name}."):
            return section, name, *filter(None, rest.removeprefix(name).split("."))
    return _with_numbers(data, split_key(key))


def _with_numbers(data: Any, parts: tuple[str, ...]) -> Path:
    """Turn the parts of a path that count in a list into numbers, as the places of a document have them."""
    path: list[str | int] = []
    for part in parts:
        is_list = isinstance(data, list)
        path.append(int(part) if is_list and part.isdecimal() else part)
        if is_list:
            data = data[int(part)] if part.isdecimal() and int(part) < len(data) else None
        else:
            data = data.get(part) if isinstance(data, Mapping) else None
    return tuple(path)
