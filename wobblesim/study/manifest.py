"""The manifest: a run is there if, and only if, a line of it says so.

One line of JSON for each thing that happened, appended and flushed to the disk before anyone relies on it. Each ends
with a checksum of itself and begins from the checksum of the line before, so that an altered, lost or doubled line is
found. The process that holds the folder writes ``manifest.jsonl``; each shard of a job array writes one of its own,
``manifest-2-of-8.jsonl``, and the next process that holds the whole folder takes those in.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wobblesim.study.errors import StoreError, not_written, reason
from wobblesim.study.files import FileRecord, damage, flush, read_about

MANIFEST, SHARD_MANIFESTS = "manifest.jsonl", "manifest-*-of-*.jsonl"

RunKey = tuple[str, int]
"""A condition's id and a seed."""

OF_DATASET = re.compile(r"(runs|epochs|trials|behaviours)/condition=([^/\\\0]+)/seeds?-[0-9A-Za-z-]+\.parquet")
"""Paths that a line may name: a forged one cannot lead out of the folder."""

LONGEST_NAME = 240
"""Bytes that the name of a folder leaves for the id of a condition, on most file systems."""

UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True, slots=True)
class Run:
    """What the manifest says of a run.

    Attributes
    ----------
    status : str
        "ok" or "failed".
    diverged, refined : int
        Trials.
    files : dict of str to FileRecord
        By table; a file of a compacted condition holds many runs.
    """

    status: str
    diverged: int
    refined: int
    files: dict[str, FileRecord]


@dataclass
class Manifest:
    """What a folder holds.

    Attributes
    ----------
    conditions : dict
        By id, in the order in which they were added, what the condition is: ``{"config": ..., "kernel": ...}``.
    studies : list of (list of str, tuple of int)
        Condition ids and seeds that were asked for, by each command that asked for something new.
    configs : set of str
        sha256 of each text that ``config.yaml`` may hold.
    runs : dict
        By (condition id, seed).
    failures : dict
        By (condition id, seed), why a run came to no result; a later commit of the run removes it.
    unreadable : list of str
        Lines that say nothing, such as one cut off by a crash; their runs do not count.
    faults : list of (Path, int, str)
        File, number and fault of each line that is not as it was written, those that say nothing among them.
    """

    conditions: dict[str, dict[str, Any]] = field(default_factory=dict)
    studies: list[tuple[list[str], tuple[int, ...]]] = field(default_factory=list)
    configs: set[str] = field(default_factory=set)
    runs: dict[RunKey, Run] = field(default_factory=dict)
    failures: dict[RunKey, str] = field(default_factory=dict)
    unreadable: list[str] = field(default_factory=list)
    faults: list[tuple[Path, int, str]] = field(default_factory=list)

    def take(self, line: Mapping[str, Any]) -> None:
        """Take in one line; one of `UNREADABLE` if it says nothing."""
        kind = line["kind"]
        if kind == "run":
            key = _name(line["condition"]), int(line["seed"])
            self.runs[key] = _run(line["status"], line["diverged"], line.get("refined", 0), _files(line))
            self.failures.pop(key, None)
        elif kind == "condition":
            config, kernel = dict(line["config"]), str(line["kernel"])
            self.conditions[_name(line["condition"])] = {"config": config, "kernel": kernel}
        elif kind == "study":
            self.studies.append((list(map(_name, line["conditions"])), seeds_of(line["seeds"])))
            self.configs.add(str(line["config"]))
        elif kind == "failure":
            runs = {(_name(line["condition"]), int(seed)) for seed in line["seeds"]} - self.runs.keys()
            self.failures |= dict.fromkeys(runs, str(line["error"]).encode(errors="replace").decode())
        elif kind == "lost":
            for seed in line["seeds"]:
                self.runs.pop((str(line["condition"]), int(seed)), None)
        elif kind == "compact":
            files = _files(line)
            for seed, status, diverged, refined in line["runs"]:
                self.runs[_name(line["condition"]), int(seed)] = _run(status, diverged, refined, files)
        else:
            raise KeyError(kind)

    def files(self, table: str) -> list[FileRecord]:
        """Files of a table: by condition, then seed."""
        order = {condition: place for place, condition in enumerate(self.conditions)}
        keys = sorted(self.runs, key=lambda key: (order.get(key[0], len(order)), key))
        files = (self.runs[key].files.get(table) for key in keys)
        return list(dict.fromkeys(file for file in files if file))

    def every_file(self) -> dict[str, FileRecord]:
        """All files of all tables, by path."""
        return {file.path: file for run in self.runs.values() for file in run.files.values()}

    def wanted(self) -> dict[str, set[int]]:
        """Seeds asked for, or there, by condition."""
        wanted: dict[str, set[int]] = {condition: set() for condition in self.conditions}
        for conditions, seeds in self.studies:
            for condition in conditions:
                wanted.setdefault(condition, set()).update(seeds)
        for condition, seed in self.runs:
            wanted.setdefault(condition, set()).add(seed)
        return wanted


def packed(seeds: Sequence[int]) -> str | list[int]:
    """Seeds as a line lists them: ``0..99`` where they are a range."""
    first, last = seeds[0], seeds[-1]
    is_range = len(seeds) > 2 and tuple(seeds) == tuple(range(first, last + 1))
    return f"{first}..{last}" if is_range else list(seeds)


def seeds_of(packed: str | Sequence[int]) -> tuple[int, ...]:
    """The seeds that a line lists.

    Raises
    ------
    ValueError
        If there are more than any study has.
    """
    if not isinstance(packed, str):
        return tuple(map(int, packed))
    first, last = map(int, packed.split(".."))
    if last - first >= MOST_SEEDS:
        raise ValueError(f"more than {MOST_SEEDS:,} seeds")
    return tuple(range(first, last + 1))


MOST_SEEDS = 1_000_000


def told(run: Run) -> dict[str, Any]:
    """What a line says of a run besides its files."""
    return {"status": run.status, "diverged": run.diverged, "refined": run.refined}


def listed(manifest: Manifest, keys: Sequence[RunKey]) -> list[list[Any]]:
    """Runs as a line of a compacted condition lists them."""
    return [[key[1], *told(manifest.runs[key]).values()] for key in keys]


def _name(condition: str) -> str:
    """The id of a condition; ValueError if it is none that could be shown."""
    name = str(condition)
    if not name.isprintable() or len(name.encode()) > LONGEST_NAME:
        raise ValueError("an id that cannot be shown, or be that of a folder")
    return name


def _run(status: str, diverged: int, refined: int, files: dict[str, FileRecord]) -> Run:
    return Run(str(status), int(diverged), int(refined), files)


def _files(line: Mapping[str, Any]) -> dict[str, FileRecord]:
    found = {table: FileRecord(**file) for table, file in line["files"].items()}
    for table, file in found.items():
        match = OF_DATASET.fullmatch(file.path)
        if not match or match.groups() != (table, line["condition"]) or match[2] in (".", ".."):
            raise ValueError("a path out of the dataset of its table and condition")
        if not (type(file.rows) is type(file.bytes) is int and isinstance(file.sha256, str)):
            raise TypeError("no count of rows and bytes")
    return found


# --- lines ---------------------------------------------------------------------------------------------------------

CHECK = re.compile(rb'(.*), "check": "([0-9a-f]{16})"\}', re.DOTALL)


def sealed(line: Mapping[str, Any], after: str) -> tuple[bytes, str]:
    """A line as it is stored, without its end, and its checksum; `after` is that of the line before."""
    body = json.dumps({**line, "after": after}).encode()
    check = _checksum(body)
    return body[:-1] + f', "check": "{check}"}}'.encode(), check


def sealed_all(lines: Iterable[Mapping[str, Any]], after: str = "") -> tuple[bytes, str]:
    """Lines as they are stored, and the checksum of the last; `after` is that of the line before them."""
    raws = []
    for line in lines:
        raw, after = sealed(line, after)
        raws.append(raw + b"\n")
    return b"".join(raws), after


def _checksum(body: bytes) -> str:
    return hashlib.sha256(body).hexdigest()[:16]


def check_of(raw: bytes) -> str | None:
    """The checksum of a stored line; None if it has none, or another than its own."""
    match = CHECK.fullmatch(raw)
    if match and _checksum(match[1] + b"}") == match[2].decode():
        return match[2].decode()
    return None


@dataclass(frozen=True)
class Line:
    """A line as found.

    Attributes
    ----------
    number : int
        From 1.
    content : dict or None
        None if it says nothing that can be trusted.
    fault : str
        What is wrong with it, empty if nothing is.
    """

    number: int
    content: dict[str, Any] | None
    fault: str = ""


def read_lines(path: Path) -> Iterator[Line]:
    """Each line of a manifest, with what is wrong with it.

    Lines of versions that wrote no checksums are taken as they are, as long as no other has come before.

    Raises
    ------
    StoreError
        If the system refuses to read it.
    """
    try:
        raws = path.read_bytes().split(b"\n")
    except FileNotFoundError:
        raise  # a shard's may be taken in, and removed, at any time
    except OSError as error:
        raise StoreError(f"cannot read {path}: {reason(error)}") from error
    before, any_sealed, after_gap = "", False, False
    for number, raw in enumerate(raws, start=1):
        last = number == len(raws)
        if last and not raw:
            return
        check = None if last else check_of(raw)
        content = _content(raw) if check or not (any_sealed or last) else None
        if content and not check and content.keys() & {"after", "check"}:
            content = None  # it was written with a checksum, which is not its own
        if content is None:
            yield Line(number, None, "is cut off" if last else "is damaged")
        elif check is None:
            yield Line(number, content, "has no checksum: an older version wrote it, or it is damaged")
        elif content.get("after") != before and not after_gap:
            yield Line(number, content, "does not follow the line before it: lines are lost, doubled or out of order")
        else:
            yield Line(number, content)
        before, any_sealed, after_gap = check or before, any_sealed or bool(check), content is None


def _content(raw: bytes) -> dict[str, Any] | None:
    try:
        content = json.loads(raw)
    except UNREADABLE:
        return None
    return content if isinstance(content, dict) else None


def manifests(folder: Path) -> list[Path]:
    """The manifests of a folder: that of the whole folder first, then those of shards."""
    return [path for path in (folder / MANIFEST, *sorted(folder.glob(SHARD_MANIFESTS))) if path.is_file()]


def read_manifest(folder: Path) -> Manifest:
    """Read what a folder holds; one without a manifest holds nothing."""
    while True:
        with contextlib.suppress(FileNotFoundError):  # that of a shard, taken in meanwhile: its lines are in the other
            return _read_manifest(folder)


def _read_manifest(folder: Path) -> Manifest:
    manifest = Manifest()
    for path in manifests(folder):
        for line in read_lines(path):
            fault = line.fault
            try:
                if line.content is None:
                    raise ValueError(fault)
                manifest.take(line.content)
            except UNREADABLE:
                fault = fault or "says nothing"
                manifest.unreadable.append(
                    f"{path}, line {line.number}: {fault}, and ignored; what it named is computed again"
                )
            if fault:
                manifest.faults.append((path, line.number, fault))
    _recover(folder, manifest)
    return manifest


def _recover(folder: Path, manifest: Manifest) -> None:
    """Conditions whose lines are lost, from what the files of their runs say; runs of which none says it do not count.

    Without it, nobody would know that a sweep with other settings is another condition.
    """
    for condition in sorted({name for name, _ in manifest.runs} - manifest.conditions.keys()):
        mine = [key for key in manifest.runs if key[0] == condition]
        what = next(filter(None, (_said(folder, manifest.runs[key]) for key in mine)), None)
        if what is not None:
            manifest.conditions[condition] = what
            continue
        manifest.unreadable.append(f"{folder}: no line and no file says what {condition} is; it is computed again")
        for key in mine:
            del manifest.runs[key]


def _said(folder: Path, run: Run) -> dict[str, Any] | None:
    """What a run's file says of its condition; None if it is damaged."""
    try:
        file = run.files["runs"]
        if damage(folder, file):
            return None
        told = read_about(folder / file.path)
        return {"config": dict(json.loads(told["config"])), "kernel": told["kernel"]}
    except (StoreError, *UNREADABLE):
        return None


class Writer:
    """Appends to a manifest; the only one who does, which is what the lock of the folder is for.

    Parameters
    ----------
    path : Path
        A line that a crash cut off is removed.

    Raises
    ------
    WriteError
        If the system refuses.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._after = _last_check(path) if path.exists() else ""
        except OSError as error:
            raise not_written(path, error) from error

    def append(self, lines: Sequence[Mapping[str, Any]]) -> None:
        """Add lines; they are on the disk when this returns.

        Raises
        ------
        WriteError
            If the system refuses; what was begun of the lines is taken back.
        """
        content, after = sealed_all(lines, self._after)
        is_new = not self.path.exists()
        try:
            with self.path.open("ab") as file:
                start = file.tell()
                try:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
                except OSError:
                    os.truncate(self.path, start)
                    raise
            if is_new:
                flush(self.path.parent)
        except OSError as error:
            raise not_written(self.path, error, len(content)) from error
        self._after = after


def _last_check(path: Path) -> str:
    """Remove the line that a crash cut off, if there is one, and return the checksum of the last line before it."""
    content = path.read_bytes()
    whole = content.rfind(b"\n") + 1
    if whole < len(content):
        os.truncate(path, whole)
    lines = content[:whole].split(b"\n")
    return next((check for line in reversed(lines[-100:]) if (check := check_of(line))), "")
