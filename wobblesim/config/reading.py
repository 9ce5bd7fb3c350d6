"""Reading YAML as data with places: every value knows the line and column where it was written.

Only what a configuration needs is understood: mappings, lists, text, numbers, true, false and null. Whatever YAML
readers disagree about is refused with the spelling to use instead (``no``, ``010``, ``12:30:45``, ``1_000``), and so
are duplicate keys, tags and merge keys. An alias (``*a``) is a copy of the value that has its anchor (``&a``), and all
aliases of a file together stand for a limited number of values, which disarms documents that grow when expanded.
"""

from __future__ import annotations

import re
import stat
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path as FilePath
from typing import Any

import yaml

from wobblesim.config.errors import ConfigError, Place, dotted
from wobblesim.config.fields import Path, shown

MAX_BYTES = 1_000_000
MAX_DEPTH = 12
MAX_DIGITS = 19
MAX_VALUES = 200_000
MAX_COPIED = 10_000
MAX_KEY = 200

# libyaml's scanner where PyYAML was built with it; the pure Python one reads the same, but slower.
LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

WORDS = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
WORDS |= {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9]*)")
DECIMAL = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
INFINITE = re.compile(r"(?i:[-+]?\.inf|\.nan)")
AMBIGUOUS = (
    (re.compile(r"(?i:y|n|yes|no|on|off)"), "is read as true or false by some YAML readers; write true or false"),
    (re.compile(r"[-+]?0[0-9]+"), "has a leading zero, which some YAML readers take for octal; leave the zero out"),
    (re.compile(r"[-+]?0[xXoObB][0-9a-fA-F_]+"), "is not a decimal number; write it with the digits 0 to 9"),
    (
        re.compile(r"[-+]?[0-9][0-9_]*(?::[0-9]+)+(?:\.[0-9_]*)?"),
        "is base 60 to some readers; write one number",
    ),
    (re.compile(r"[-+]?[0-9.]*[0-9]_[0-9_.]*(?:[eE][-+]?[0-9]+)?"), "has an underscore; write the digits together"),
)


OPEN = object()
"""Stands for the value of an anchor while it is being read."""


@dataclass
class Document:
    """Data with the places where its keys and values were written.

    Attributes
    ----------
    source : str
        File name, ``<stdin>`` or option.
    data : dict
        Plain data: dict, list, str, int, float, bool, None.
    values, keys : dict
        Place of each value, and of each key of a mapping, by path.
    """

    source: str
    data: Any = None
    values: dict[Path, Place] = field(default_factory=dict)
    keys: dict[Path, Place] = field(default_factory=dict)

    def place(self, path: Path, *, about_key: bool = False) -> Place:
        """Return the place of a value (or key), or of the nearest thing around it that was written."""
        first, second = (self.keys, self.values) if about_key else (self.values, self.keys)
        while path:
            place = first.get(path) or second.get(path)
            if place:
                return place
            path, first, second = path[:-1], self.keys, self.values
        return self.values.get((), Place(self.source))

    def forget(self, path: Path) -> None:
        """Drop the places at and below a path, whose value is about to be replaced."""
        for places in (self.values, self.keys):
            for old in [old for old in places if old[: len(path)] == path]:
                del places[old]


def read_text(path: str | FilePath) -> tuple[str, str]:
    """Return the text of a file, or of standard input for ``-``, and the name by which errors call it.

    Raises
    ------
    ConfigError
        For anything but UTF-8 text of at most 1 MB in a regular file.
    """
    source = "<stdin>" if str(path) == "-" else str(path)
    raw = sys.stdin.buffer.read(MAX_BYTES + 1) if str(path) == "-" else _file_bytes(source)
    return _decoded(raw, source), source


def _file_bytes(path: str) -> bytes:
    try:
        mode = FilePath(path).stat().st_mode
        if stat.S_ISDIR(mode):
            raise ConfigError("is a folder; give a YAML file", Place(path))
        if not stat.S_ISREG(mode):
            raise ConfigError("is not a regular file; give a YAML file, or - to read standard input", Place(path))
        with FilePath(path).open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ConfigError(f"there is no such file{_sibling(path)}", Place(path)) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot be read: {reason}", Place(path)) from None


def _sibling(path: str) -> str:
    """Name a file beside a missing one that has a similar name."""
    folder = FilePath(path).parent
    names = [f.name for f in folder.glob("*.y*ml")] if folder.is_dir() else []
    near = get_close_matches(FilePath(path).name, names, 1)
    return f" (did you mean '{folder / near[0]}'?)" if near else "; give the path of a YAML file"


def _decoded(raw: bytes, source: str) -> str:
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"is larger than {MAX_BYTES:,} bytes, too much for a configuration", Place(source))
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ConfigError("is UTF-16 text; save it as UTF-8", Place(source))
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        place = Place(source, before.count(b"\n") + 1, error.start - before.rfind(b"\n"))
        raise ConfigError("is not UTF-8 text; save it as UTF-8", place) from None
    if "\0" in text:
        raise ConfigError("is a binary file; give a YAML file", Place(source, text[: text.index("\0")].count("\n") + 1))
    return text


def read_document(text: str, source: str) -> Document:
    """Read YAML text whose top is a mapping; ``source`` names it in errors."""
    document = Document(source)
    _Reader(text, document).read()
    if document.data is None:
        raise ConfigError("is empty; the shortest configuration is 'name: my-study'", Place(source))
    if not isinstance(document.data, dict):
        kind = "a list" if isinstance(document.data, list) else "a single value"
        raise ConfigError(f"holds {kind}; a configuration is a mapping such as 'name: my-study'", document.place(()))
    return document


def read_value(text: str, source: str, path: Path) -> Document:
    """Read the value of an option, to be put at a path; all its places are the option."""
    document = Document(source)
    _Reader(text, document, path, lines=False).read()
    return document


class _Reader:
    """Build a document from YAML's events, which are read one by one, so that a bad one stops the reading."""

    def __init__(self, text: str, document: Document, path: Path = (), lines: bool = True):
        self.document, self.path, self.lines = document, path, lines
        self.text = text
        self.events: Iterator[Any] = iter(())
        self.anchored: dict[str, Any] = {}
        self.copied = 0

    def read(self) -> None:
        try:
            self.events = iter(yaml.parse(self.text, Loader=LOADER))
            self._stream()
        except UnicodeEncodeError:  # half a character: an argument of the command line that is not UTF-8
            raise ConfigError("is not UTF-8 text; write it as UTF-8", Place(self.document.source)) from None
        except yaml.reader.ReaderError as error:
            line = self.text[: error.position].count("\n") + 1
            raise ConfigError(f"character #x{error.character:04x} is not allowed in YAML", self._at(line)) from None
        except yaml.MarkedYAMLError as error:
            raise self._syntax_error(error) from None

    def _stream(self) -> None:
        documents = 0
        for event in self.events:
            if not isinstance(event, yaml.DocumentStartEvent):
                continue
            documents += 1
            if documents > 1:
                raise self._error("a second document starts here; give one configuration a file", event)
            self.document.data = self._node(next(self.events), self.path, 0)

    def _node(self, event: Any, path: Path, depth: int) -> Any:
        self._enter(event, path, depth)
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, path, depth)
        if event.tag is not None:
            tag = shown(event.tag.replace("tag:yaml.org,2002:", "!!"))
            raise self._error(f"the tag {tag} is not supported; write a plain value", event, path)
        if event.anchor in self.anchored:  # the later one to some readers, an error to others
            raise self._error(f"the anchor {shown(f'&{event.anchor}')} is given twice; rename one", event, path)
        if event.anchor:
            self.anchored[event.anchor] = OPEN
        value = self._value(event, path, depth)
        if event.anchor:
            self.anchored[event.anchor] = value
        return value

    def _enter(self, event: Any, path: Path, depth: int) -> None:
        """Note the place of a value, and refuse one too many or too deep."""
        self.document.values[path] = self._place(event)
        if len(self.document.values) > MAX_VALUES:
            raise self._error(f"has more than {MAX_VALUES:,} values, too many for a configuration", event)
        if depth > MAX_DEPTH:
            raise self._error(f"is nested deeper than {MAX_DEPTH} levels, more than a configuration needs", event)

    def _value(self, event: Any, path: Path, depth: int) -> Any:
        if isinstance(event, yaml.MappingStartEvent):
            return self._mapping(path, depth)
        if isinstance(event, yaml.SequenceStartEvent):
            return self._sequence(path, depth)
        return self._scalar(event, path)

    def _alias(self, event: Any, path: Path, depth: int) -> Any:
        alias, anchor = shown(f"*{event.anchor}"), shown(f"&{event.anchor}")
        if event.anchor not in self.anchored:
            raise self._error(f"the alias {alias} has no anchor {anchor} before it; write the value out", event, path)
        if self.anchored[event.anchor] is OPEN:
            raise self._error(f"the alias {alias} stands inside its anchor {anchor}; write the value out", event, path)
        return self._copy(self.anchored[event.anchor], event, path, depth)

    def _copy(self, value: Any, event: Any, path: Path, depth: int) -> Any:
        """Copy a value to where an alias stands, which is the place of all that is in it."""
        self.copied += 1
        if self.copied > MAX_COPIED:
            raise self._error(
                f"the aliases (*) stand for more than {MAX_COPIED:,} values, too many for a configuration", event, path
            )
        self._enter(event, path, depth)
        if isinstance(value, list):
            return [self._copy(item, event, (*path, i), depth + 1) for i, item in enumerate(value)]
        if not isinstance(value, dict):
            return value
        self.document.keys.update(dict.fromkeys(((*path, key) for key in value), self._place(event)))
        return {key: self._copy(item, event, (*path, key), depth + 1) for key, item in value.items()}

    def _mapping(self, path: Path, depth: int) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            inner = (*path, self._key(event, path))
            if inner[-1] in mapping:
                first = self.document.keys[inner].line
                before = f", first on line {first}" if first else ""
                raise self._error(f"is given twice{before}; remove one", event, inner)
            self.document.keys[inner] = self._place(event)
            mapping[inner[-1]] = None
            mapping[inner[-1]] = self._node(next(self.events), inner, depth + 1)
        return mapping

    def _key(self, event: Any, path: Path) -> str:
        """Keys are text, whatever they look like."""
        if not isinstance(event, yaml.ScalarEvent):
            raise self._error("a key must be a word", event, path)
        if event.anchor or event.tag is not None:
            raise self._error("a key has no anchor (&) and no tag (!); write a plain key", event, path)
        if event.implicit[0] and event.value == "<<":
            raise self._error(
                "merge keys (<<) are not supported; write under conditions only what differs from the base", event, path
            )
        if len(event.value) > MAX_KEY:
            raise self._error(f"a key of {len(event.value):,} characters is no key of a configuration", event, path)
        if event.value == "":
            raise self._error("a key is missing before the colon", event, path)
        return event.value

    def _sequence(self, path: Path, depth: int) -> list[Any]:
        items: list[Any] = []
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            items.append(self._node(event, (*path, len(items)), depth + 1))
        return items

    def _scalar(self, event: Any, path: Path) -> Any:
        is_plain = event.implicit[0]
        try:
            return plain_value(event.value) if is_plain else event.value
        except ValueError as error:
            raise self._error(f"{shown(event.value)} {error}", event, path) from None

    def _syntax_error(self, error: yaml.MarkedYAMLError) -> ConfigError:
        mark = error.problem_mark or error.context_mark
        place = self._at(mark.line + 1, mark.column + 1) if mark else Place(self.document.source)
        lines = self.text.splitlines()
        if mark and mark.line < len(lines) and lines[mark.line][mark.column : mark.column + 1] == "\t":
            return ConfigError("a tab cannot be used here; indent with spaces", place)
        reason = error.problem or " ".join(str(part) for part in error.args if isinstance(part, str))
        context = f" {error.context}" if error.context else ""
        hint = "; a value with a colon needs quotes" if "mapping values" in reason else ""
        return ConfigError(f"is not valid YAML:{context} {reason}{hint}", place)

    def _error(self, message: str, event: Any, path: Path = ()) -> ConfigError:
        return ConfigError(message, self._place(event), dotted(path))

    def _place(self, event: Any) -> Place:
        return self._at(event.start_mark.line + 1, event.start_mark.column + 1)

    def _at(self, line: int, column: int | None = None) -> Place:
        return Place(self.document.source, line, column) if self.lines else Place(self.document.source)


def plain_value(text: str) -> Any:
    """Return what an unquoted scalar means: null, true, false, a number or text.

    Numbers that cannot be held (``1e999``, more than 19 digits) come out as the nearest float, infinity included, so
    that the schema refuses them with the range of their key.

    Raises
    ------
    ValueError
        Where YAML readers disagree; the message says what to write.
    """
    if text in WORDS:
        return WORDS[text]
    for pattern, reason in AMBIGUOUS:
        if pattern.fullmatch(text):
            raise ValueError(f"{reason}, or put it in quotes if it is text")
    if INTEGER.fullmatch(text) and len(text.lstrip("+-")) <= MAX_DIGITS:
        return int(text)
    if DECIMAL.fullmatch(text):
        return float(text)
    if INFINITE.fullmatch(text):
        return float(text.replace(".", ""))
    return text
