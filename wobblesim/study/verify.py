"""Is every file, bit for bit, what was written, and nothing else there? Only reads: a sweep may be at work meanwhile.

Who writes moves files to their places first, and says so in the manifest then. So the datasets are listed before the
manifest is read: a file that is not in the manifest was there before its line, and whatever seems wrong while somebody
writes is looked at again, until it is right or has had its time.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wobblesim.study import resume
from wobblesim.study.errors import StoreError, first_line, reason
from wobblesim.study.files import FileRecord, about_of, damage, read_about
from wobblesim.study.lock import writers
from wobblesim.study.manifest import MANIFEST, OF_DATASET, Manifest, Run, RunKey, manifests, read_manifest, told
from wobblesim.study.schema import COLUMNS, SCHEMA_VERSION, TABLES_OF_LOG, WITH_GENOTYPE, schema
from wobblesim.study.store import CHECKPOINTS, CONFIG

PATIENCE = 5.0
"""s for which what seems wrong is looked at again while somebody writes."""

THREADS = min(8, os.cpu_count() or 1)

SWEEP = "the sweep command, given again, computes its runs anew"
REPAIR = "`wobblesim verify --repair` puts it aside, and the sweep command, given again, computes its runs anew"
ASIDE = "`wobblesim verify --repair` puts it aside"
REMOVE = "remove it: the sweep refuses to write through it"
REWRITE = "`wobblesim verify --repair` keeps what is sound, and the sweep command, given again, computes the rest anew"
CONFIG_AGAIN = "the sweep command, given again, writes it anew"


class Finding(NamedTuple):
    """What is not as it should be.

    Attributes
    ----------
    path : str
        Relative to the folder.
    what : str
        What is wrong with it.
    remedy : str
    """

    path: str
    what: str
    remedy: str


@dataclass(frozen=True)
class Verified:
    """What came of looking at a folder.

    Attributes
    ----------
    folder : Path
    runs, files, bytes, rows : int
        What the manifest names and is sound; of a sound run, every file is.
    seconds : float
    findings : tuple of Finding
    pending : tuple of str
        Files that no line of the manifest names yet, while somebody writes: not judged.
    writers : tuple of str
        Who was writing.
    """

    folder: Path
    runs: int
    files: int
    bytes: int
    rows: int
    seconds: float
    findings: tuple[Finding, ...]
    pending: tuple[str, ...]
    writers: tuple[str, ...]


Tell = Callable[[int, int], None]
"""Called with the bytes read so far and those to read."""


def verify(folder: Path, tell: Tell | None = None, patience: float = PATIENCE) -> Verified:
    """Look at all that a folder of results holds.

    Parameters
    ----------
    folder : Path
    tell : callable, optional
        Called with the bytes read so far and those to read.
    patience : float
        s for which what seems wrong is looked at again while somebody writes.

    Raises
    ------
    StoreError
        If it is no folder of results.
    """
    return Inspection(folder, tell).verdict(patience)


@dataclass(frozen=True)
class Expected:
    """A file as the manifest tells of it; `what` is its condition's settings and kernel."""

    table: str
    file: FileRecord
    condition: str
    runs: tuple[tuple[int, Run], ...]
    what: Mapping[str, Any] = field(hash=False)

    @property
    def seeds(self) -> list[int]:
        """Of its runs, in order."""
        return [seed for seed, _ in self.runs]


def expected(manifest: Manifest) -> list[Expected]:
    """Every file that the manifest names, with what should be in it."""
    found: dict[tuple[str, FileRecord], list[tuple[int, Run]]] = defaultdict(list)
    condition_of = {}
    for (condition, seed), run in sorted(manifest.runs.items(), key=lambda item: item[0]):
        for table, file in run.files.items():
            found[table, file].append((seed, run))
            condition_of[file] = condition
    return [
        Expected(table, file, condition_of[file], tuple(runs), manifest.conditions[condition_of[file]])
        for (table, file), runs in found.items()
    ]


# --- looking -------------------------------------------------------------------------------------------------------


@dataclass
class Look:
    """What one look has shown.

    Attributes
    ----------
    manifest : Manifest
    expected : list of Expected
    faulty : dict of str to Finding
        By path, files of the manifest.
    strangers : dict of str to Finding
        By path, what is in the datasets besides them.
    others : list of Finding
        In the manifest itself, the configuration and the checkpoints.
    """

    manifest: Manifest
    expected: list[Expected]
    faulty: dict[str, Finding]
    strangers: dict[str, Finding]
    others: list[Finding]

    @property
    def findings(self) -> list[Finding]:
        """All of them."""
        return [*self.others, *self.faulty.values(), *self.strangers.values()]

    @property
    def lost(self) -> set[RunKey]:
        """Runs that cannot be relied on."""
        faulty = {(it.condition, seed) for it in self.expected if it.file.path in self.faulty for seed in it.seeds}
        return faulty | set(_unfit(self.manifest))


class Inspection:
    """Looks at a folder, again if need be; what was found sound once is not read again."""

    def __init__(self, folder: Path, tell: Tell | None = None) -> None:
        self.folder = folder
        self._tell = tell or (lambda done, total: None)
        self._sound: set[tuple[FileRecord, tuple[int, ...]]] = set()

    def verdict(self, patience: float = PATIENCE) -> Verified:
        """Look until all is well, nobody writes, or time is over."""
        started, deadline = time.monotonic(), None
        while True:
            busy = writers(self.folder) if self.folder.is_dir() else []
            seen = self.look()
            deadline = deadline or time.monotonic() + patience
            if not seen.findings or not busy or time.monotonic() > deadline:
                break
            time.sleep(0.1)
        # A file may wait for its line longer than we do; who holds the folder has put aside what was left of old.
        pending = {path for path in seen.strangers if busy and OF_DATASET.fullmatch(path)}
        strangers = [finding for path, finding in seen.strangers.items() if path not in pending]
        sound = [it for it in seen.expected if it.file.path not in seen.faulty]
        return Verified(
            self.folder,
            runs=len(seen.manifest.runs.keys() - seen.lost),
            files=len(sound),
            bytes=sum(it.file.bytes for it in sound),
            rows=sum(it.file.rows for it in sound),
            seconds=time.monotonic() - started,
            findings=(*seen.others, *seen.faulty.values(), *strangers),
            pending=tuple(sorted(pending)),
            writers=tuple(busy),
        )

    def look(self) -> Look:
        """Look once."""
        there = dict(_listing(self.folder))
        if not manifests(self.folder) and not there and not (self.folder / CONFIG).is_file():
            raise StoreError(f"{self.folder} holds no results; give the folder that a sweep has written")
        manifest = read_manifest(self.folder)
        wanted = expected(manifest)
        faulty = self._faulty(wanted, there)
        named = {it.file.path: it.file for it in wanted}
        strangers = {path: self._stranger(path, there[path], manifest, named) for path in there.keys() - named.keys()}
        others = [*_of_manifest(self.folder, manifest), *_of_config(self.folder, manifest)]
        others += _of_checkpoints(self.folder)
        return Look(manifest, wanted, faulty, dict(sorted(strangers.items())), others)

    def _faulty(self, wanted: list[Expected], there: Mapping[str, str]) -> dict[str, Finding]:
        """The files that are not what the manifest says, by path."""
        fresh = [it for it in wanted if (it.file, tuple(it.seeds)) not in self._sound]
        done, total = 0, sum(it.file.bytes for it in fresh)
        found = {}
        with ThreadPoolExecutor(THREADS) as pool:
            for it, fault in zip(fresh, pool.map(lambda it: self._fault(it, there), fresh), strict=True):
                done += it.file.bytes
                self._tell(done, total)
                if fault is None:
                    self._sound.add((it.file, tuple(it.seeds)))
                else:
                    found[it.file.path] = Finding(it.file.path, *fault)
        return found

    def _fault(self, it: Expected, there: Mapping[str, str]) -> tuple[str, str] | None:
        if there.get(it.file.path, "file") != "file":
            return f"is {there[it.file.path]}", REPAIR
        if what := damage(self.folder, it.file):
            return what, REPAIR if "altered" in what else SWEEP
        if what := fault_of_content(self.folder / it.file.path, it):
            return what, REPAIR
        return None

    def _stranger(self, path: str, kind: str, manifest: Manifest, named: Mapping[str, FileRecord]) -> Finding:
        """What a thing in the datasets is that no line of the manifest names."""
        if kind != "file":
            remedy = REMOVE if path.count("/") < 2 else ASIDE
            return Finding(_printable(path), f"is {kind}, where a sweep puts plain files only", remedy)
        content = self.folder / path
        try:
            length = content.stat().st_size
            for file in named.values():
                if file.bytes == length and damage(self.folder, file._replace(path=path)) is None:
                    return Finding(_printable(path), f"is a copy of {file.path}", ASIDE)
            told = read_about(content)
            runs = [(told["condition"], seed) for seed in _seeds(told)]
            held = [manifest.runs[run].files.get(told["table"]) for run in runs if run in manifest.runs]
        except (OSError, StoreError, ValueError, KeyError, TypeError, RecursionError):
            return Finding(_printable(path), "is foreign: no sweep has written it", ASIDE)
        if held and held[0]:
            return Finding(_printable(path), f"holds a run that {held[0].path} holds", ASIDE)
        return Finding(_printable(path), "belongs to no run: no line of the manifest names it", ASIDE)


def _listing(folder: Path) -> Iterator[tuple[str, str]]:
    """All in the datasets but folders, as it lies there: relative path, and "file" or what else it is."""
    for table in COLUMNS:
        place = folder / table
        if place.is_symlink() or (place.exists() and not place.is_dir()):
            yield table, _kind(place)
        else:
            yield from _below(place, table)


def _below(place: Path, relative: str) -> Iterator[tuple[str, str]]:
    try:
        with os.scandir(place) as entries:
            for entry in entries:
                path = f"{relative}/{entry.name}"
                if entry.is_dir(follow_symlinks=False):
                    yield from _below(place / entry.name, path)
                else:
                    yield path, "file" if entry.is_file(follow_symlinks=False) else _kind(place / entry.name)
    except FileNotFoundError:
        return
    except OSError as error:
        yield relative, f"a folder that cannot be read ({reason(error)})"


def _kind(path: Path) -> str:
    mode = path.lstat().st_mode
    return "a link" if stat.S_ISLNK(mode) else "a file" if stat.S_ISREG(mode) else "a device, pipe or socket"


def _printable(path: str) -> str:
    """A name as it can be shown: a foreign one may hold what a terminal obeys."""
    return path if path.isprintable() else ascii(path)[1:-1]


# --- the content of a file -----------------------------------------------------------------------------------------


def fault_of_content(path: Path, it: Expected) -> str | None:
    """What is wrong with the content of a file that is, bit for bit, what was written; None if nothing is."""
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as parquet:
            return (
                _fault_of_metadata(about_of(path, parquet.metadata), it)
                or _fault_of_columns(parquet, it)
                or _fault_of_rows(parquet, it)
            )
    except (OSError, pa.ArrowException, StoreError, ValueError, KeyError, TypeError, RecursionError) as error:
        return f"cannot be read: {first_line(error)}"


def _fault_of_metadata(told: Mapping[str, str], it: Expected) -> str | None:
    """Whether a file says of itself what the manifest says."""
    wanted = {"table": it.table, "condition": it.condition, "seeds": it.seeds, **it.what}
    found = {**told, "seeds": _seeds(told), "config": json.loads(told["config"])}
    differing = [name for name in wanted if wanted[name] != found[name]]
    return f"says another {' and '.join(differing)} of itself than the manifest" if differing else None


def _seeds(told: Mapping[str, str]) -> list[int]:
    """The seeds that a file says it has."""
    return [int(seed) for seed in json.loads(told["seeds"])] if "seeds" in told else [int(told["seed"])]


def _fault_of_columns(parquet: pq.ParquetFile, it: Expected) -> str | None:
    if parquet.metadata.num_rows != it.file.rows:
        return f"has {parquet.metadata.num_rows:,} rows where the manifest says {it.file.rows:,}"
    columns = parquet.schema_arrow.remove_metadata()
    genes = columns.field("genotype").type.list_size if it.table in WITH_GENOTYPE else 0
    if not columns.equals(schema(it.table, genes)):
        return f"has other columns than tables of version {SCHEMA_VERSION} have"
    return None


def _fault_of_rows(parquet: pq.ParquetFile, it: Expected) -> str | None:
    """Read all of it, a row group at a time, so that every page is held against its checksum."""
    seeds: list[int] = []
    for group in range(parquet.num_row_groups):
        rows = parquet.read_row_group(group, use_threads=False)
        if rows["condition"].unique().to_pylist() != [it.condition]:
            return "has rows of another condition"
        seed = rows["seed"].to_numpy()
        seeds += [int(seed[place]) for place in np.flatnonzero(np.diff(seed, prepend=seed[0] - 1))]
        if it.table == "runs" and (what := _fault_of_results(rows, dict(it.runs))):
            return what
    if [seed for seed, _ in groupby(seeds)] != it.seeds:
        return "has rows of other seeds than the manifest says, or in another order"
    return None


def _fault_of_results(rows: pa.Table, runs: Mapping[int, Run]) -> str | None:
    for row in rows.select(["seed", "status", "diverged", "refined"]).to_pylist():
        seed = row.pop("seed")
        if seed in runs and row != told(runs[seed]):
            return f"says of seed {seed} what the manifest does not say"
    return None


# --- the rest of a folder ------------------------------------------------------------------------------------------


def _of_manifest(folder: Path, manifest: Manifest) -> Iterator[Finding]:
    if not manifests(folder):
        yield Finding(MANIFEST, "is missing", "put it back, or give the sweep command again: it computes all anew")
    for (path, fault), lines in groupby(manifest.faults, key=lambda it: (it[0], it[2])):
        numbers = [number for _, number, _ in lines]
        which = f"line {numbers[0]}" if len(numbers) == 1 else f"lines {numbers[0]} to {numbers[-1]}"
        yield Finding(path.name, f"{which}: {fault}", REWRITE)
    for condition, seed in _unfit(manifest):
        yield Finding(MANIFEST, f"names other tables of {condition}, seed {seed}, than its `log` asks for", REWRITE)


def _unfit(manifest: Manifest) -> list[RunKey]:
    """Runs that have other tables than they should."""
    wanted = {
        condition: {"runs", *TABLES_OF_LOG.get(str(what["config"].get("log")), ())}
        for condition, what in manifest.conditions.items()
    }
    return [key for key, run in manifest.runs.items() if key[0] in wanted and run.files.keys() != wanted[key[0]]]


def _of_config(folder: Path, manifest: Manifest) -> Iterator[Finding]:
    """The configuration is one of those that the manifest has the hash of."""
    path = folder / CONFIG
    try:
        if hashlib.sha256(path.read_bytes()).hexdigest() not in manifest.configs:
            yield Finding(CONFIG, "is altered: it is not what a sweep has written (sha256)", CONFIG_AGAIN)
    except FileNotFoundError:
        if manifest.studies:
            yield Finding(CONFIG, "is missing", CONFIG_AGAIN)
    except OSError as error:
        yield Finding(CONFIG, f"cannot be read: {reason(error)}", CONFIG_AGAIN)


def _of_checkpoints(folder: Path) -> Iterator[Finding]:
    places = (path.parent.name for path in (folder / CHECKPOINTS).glob("condition=*/seeds-*"))
    for name, count in sorted(Counter(places).items()):
        readable = _readable(folder, name.removeprefix("condition="))
        if readable < count:
            what = f"holds {count - readable} of {count} that cannot be read"
            yield Finding(f"{CHECKPOINTS}/{name}", what, "the sweep command, given again, starts those runs anew")


def _readable(folder: Path, condition: str) -> int:
    """How many checkpoints of a condition can be read."""
    heads = resume.standing(folder, condition)
    return sum(resume.load(folder, head.group, head.identity) is not None for head in heads)
