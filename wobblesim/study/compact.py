"""One file for each condition and table in place of one for each run: the same rows, by seed, epoch and slot.

The new files are written aside and flushed to the disk, read back and compared with the old ones bit by bit, moved to
their places, and made results by one line of the manifest; only then the old ones are removed. Whatever dies in between
leaves files that no line names: the next process that holds the folder puts them into quarantine.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wobblesim.study.errors import StoreError, WriteError, first_line, not_written
from wobblesim.study.files import FileRecord, damage, flush, read_about, table_writer
from wobblesim.study.manifest import MANIFEST, Run, RunKey, listed, manifests
from wobblesim.study.schema import COLUMNS
from wobblesim.study.store import Store, attempt, opened
from wobblesim.study.verify import REPAIR, SWEEP, Finding, Tell

GROUP_ROWS, GROUP_BYTES = 2**20, 2**25
"""A row group holds whole runs up to these; a longer run has row groups of its own.

Measured with 24 runs of 15 MB each: the process takes 0.33 GB. With twice as many bytes to a group it is 0.51 GB, and
0.50 and 0.54 GB for 6 and 12 of these runs.
"""

FEW = 10_000
"""Rows for which threads cost more than they save."""

OF_A_FILE = ("table", "condition", "seed", "seeds", "sources", "schema_version", "config")
"""What a file says of itself besides where its rows come from."""

UNUSABLE = (StoreError, ValueError, KeyError, TypeError, RecursionError, pa.ArrowException)
"""What files that are, bit for bit, what was written, and yet are no good, make the functions below raise."""

Rows = Generator[tuple[int, pa.Table], None, None]
"""Seeds, and the rows of each."""


@dataclass(frozen=True)
class Merged:
    """A condition before and after.

    Attributes
    ----------
    condition : str
    runs : int
    files, bytes : (int, int)
        Before and after.
    findings : tuple of Finding
        Why it was left as it was; empty if it was not.
    """

    condition: str
    runs: int
    files: tuple[int, int]
    bytes: tuple[int, int]
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Compacted:
    """What came of compacting a folder.

    Attributes
    ----------
    folder : Path
    conditions : tuple of Merged
        Those with runs.
    notes : tuple of str
        What was found amiss, and put aside, at the begin.
    stopped : bool
        Whether `stop` ended it early; the same call goes on.
    """

    folder: Path
    conditions: tuple[Merged, ...]
    notes: tuple[str, ...]
    stopped: bool


def compact(folder: Path, tell: Tell | None = None, stop: Callable[[], bool] | None = None) -> Compacted:
    """Merge the files of each condition into one for each table.

    Parameters
    ----------
    folder : Path
    tell : callable, optional
        Called with the bytes done so far and those to do.
    stop : callable, optional
        Asked after every run; once it says True, conditions that are not finished stay as they were.

    Raises
    ------
    StoreError
        If it is no folder of results, or if somebody else writes to it.
    WriteError
        If the system refuses; nothing is lost then.
    """
    if not manifests(folder):
        raise StoreError(f"{folder} holds no results; give the folder that a sweep has written")
    with opened(folder) as store:
        notes = (*store.manifest.unreadable, *store.lost)
        keys: dict[str, list[RunKey]] = {condition: [] for condition in store.manifest.conditions}
        for key in sorted(store.manifest.runs):
            keys[key[0]].append(key)
        todo = [_Condition(store, condition, mine) for condition, mine in keys.items() if mine]
        work = _Work(sum(condition.size for condition in todo if not condition.is_compact), tell, stop)
        done: list[Merged] = []
        stopped = False
        try:
            done.extend(condition.merged(work) for condition in todo)
        except _Stopped:
            stopped = True
    return Compacted(folder, tuple(done), notes, stopped)


class _Stopped(Exception):  # noqa: N818 - nothing is wrong
    """The user asked for an end."""


class _Work:
    """Counts bytes, and asks whether to stop."""

    def __init__(self, total: int, tell: Tell | None, stop: Callable[[], bool] | None) -> None:
        self._done, self._total = 0, total
        self._tell, self._stop = tell or (lambda done, total: None), stop or (lambda: False)

    def did(self, size: int) -> None:
        """Count bytes of the old files."""
        self._done += size
        self._tell(self._done, self._total)

    def go_on(self) -> None:
        """Raise if the user asks for an end."""
        if self._stop():
            raise _Stopped


# --- a condition ---------------------------------------------------------------------------------------------------


class _Condition:
    """The runs of a condition and the files they are in."""

    def __init__(self, store: Store, condition: str, keys: Sequence[RunKey]) -> None:
        self.store, self.name, self.keys = store, condition, keys
        self.runs: list[Run] = [store.manifest.runs[key] for key in keys]
        self.seeds = [seed for _, seed in keys]
        there = {table for run in self.runs for table in run.files}
        self.tables = [table for table in COLUMNS if table in there]

    def files(self, table: str) -> list[FileRecord]:
        """Files of a table, by first seed."""
        return list(dict.fromkeys(run.files[table] for run in self.runs if table in run.files))

    @cached_property
    def old(self) -> list[FileRecord]:
        """All files."""
        return [file for table in self.tables for file in self.files(table)]

    @cached_property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.bytes for file in self.old)

    @property
    def is_compact(self) -> bool:
        """Whether each table is one file."""
        return all(len(self.files(table)) == 1 for table in self.tables)

    def merged(self, work: _Work) -> Merged:
        """Merge the files, unless there is nothing to merge, or one is damaged."""
        files, size = len(self.old), self.size
        as_it_was = Merged(self.name, len(self.runs), (files, files), (size, size))
        if self.is_compact:
            return as_it_was
        if findings := tuple(self._damaged()):
            return replace(as_it_was, findings=findings)
        scratch = attempt(self.store.scratch)
        try:
            new = {table: self._merge(table, scratch, work) for table in self.tables}
        except BaseException as error:
            shutil.rmtree(scratch, ignore_errors=True)
            if isinstance(error, WriteError) or not isinstance(error, UNUSABLE):
                raise
            finding = Finding(f"condition={self.name}", f"cannot be merged: {first_line(error)}", "it stays as it was")
            return replace(as_it_was, findings=(finding,))
        self._replace(new)
        return replace(as_it_was, files=(files, len(new)), bytes=(size, sum(file["bytes"] for file in new.values())))

    def _damaged(self) -> Iterator[Finding]:
        if any(len(run.files) < len(self.tables) for run in self.runs):
            yield Finding(MANIFEST, f"names other tables of some runs of {self.name} than of others", REPAIR)
        for file in self.old:
            if what := damage(self.store.folder, file):
                yield Finding(file.path, what, REPAIR if "altered" in what else SWEEP)

    def _merge(self, table: str, scratch: Path, work: _Work) -> dict[str, Any]:
        """Write the new file of a table; return what a manifest says of it, and where it lies."""
        staged, rows = scratch / f"{table}.parquet", 0
        groups = _groups(self._rows(table, work))
        first = next(groups, None)
        if first is None:
            raise ValueError(f"there are no rows of {table}")
        with table_writer(staged, first.schema, {"table": table, **self.about}) as writer:
            for group in chain([first], groups):
                writer.write_table(group)
                rows += len(group)
        self._compare(table, staged)
        with staged.open("rb") as content:
            sha256 = hashlib.file_digest(content, "sha256").hexdigest()
        path = f"{table}/condition={self.name}/{self._file_name()}"
        return FileRecord(path, rows, staged.stat().st_size, sha256)._asdict() | {"staged": str(staged)}

    @cached_property
    def about(self) -> dict[str, str]:
        """What the new files say of themselves."""
        paths = [self.store.folder / file.path for file in self.files("runs")]
        common = {name: read_about(paths[0])[name] for name in ("schema_version", "condition", "config")}
        sources = _sources(map(read_about, paths), common)
        first = sources[0].items()
        same = {name: value for name, value in first if all(source.get(name) == value for source in sources)}
        same.pop("seeds", None)
        return {**common, **same, "seeds": json.dumps(self.seeds), "sources": json.dumps(sources)}

    def _file_name(self) -> str:
        """A name that no file of other runs has."""
        digest = hashlib.sha256("".join(file.sha256 for file in self.old).encode()).hexdigest()
        return f"seeds-{self.seeds[0]}-{self.seeds[-1]}-{digest[:8]}.parquet"

    def _rows(self, table: str, work: _Work | None = None) -> Rows:
        """The rows of the old files, by seed; one or a few files are open at a time."""
        streams: dict[str, Rows] = {}
        last = {run.files[table].path: seed for seed, run in zip(self.seeds, self.runs, strict=True)}
        for seed, run in zip(self.seeds, self.runs, strict=True):
            if work:
                work.go_on()
            file = run.files[table]
            runs = streams.setdefault(file.path, _runs(self.store.folder / file.path))
            found, rows = next(runs, (None, None))
            if rows is None or found != seed:
                raise ValueError(f"{file.path} holds other runs than the manifest says")
            yield seed, rows
            if last[file.path] == seed:
                if next(streams.pop(file.path), None) is not None:
                    raise ValueError(f"{file.path} holds other runs than the manifest says")
                if work:
                    work.did(file.bytes)

    def _compare(self, table: str, staged: Path) -> None:
        """Read the new file, and refuse it unless it has the rows of the old ones, bit for bit."""
        with closing(_runs(staged)) as new:
            for seed, rows in self._rows(table):
                again, read = next(new, (None, None))
                if again != seed or read is None or not _same_bits(rows, read):
                    raise ValueError(f"the new file of {table} does not read as it was written (seed {seed})")

    def _replace(self, new: Mapping[str, Mapping[str, Any]]) -> None:
        """Make the new files results, then remove the old ones."""
        stay = {file["path"] for file in new.values()}
        old = [self.store.folder / file.path for file in self.old if file.path not in stay]
        runs = listed(self.store.manifest, self.keys)
        self.store.commit([{"kind": "compact", "condition": self.name, "runs": runs, "files": new}])
        for path in old:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise not_written(path, error) from error
        for folder in {path.parent for path in old}:
            try:
                flush(folder)
            except OSError as error:
                raise not_written(folder, error) from error


def _sources(abouts: Iterable[Mapping[str, str]], common: Mapping[str, str]) -> list[dict[str, Any]]:
    """The distinct origins of runs, with the seeds of each; ValueError if not all runs have those things in common."""
    found: dict[str, list[int]] = {}
    for about in abouts:
        if any(about[name] != value for name, value in common.items()):
            raise ValueError("the files are of other settings or of another version of the tables")
        origin = {name: value for name, value in about.items() if name not in OF_A_FILE}
        told = json.loads(about["sources"]) if "sources" in about else [{**origin, "seeds": [int(about["seed"])]}]
        for source in told:
            seeds = source.pop("seeds")
            found.setdefault(json.dumps(source, sort_keys=True), []).extend(seeds)
    return [{**json.loads(source), "seeds": sorted(seeds)} for source, seeds in found.items()]


# --- rows ----------------------------------------------------------------------------------------------------------


def _runs(path: Path) -> Rows:
    """The rows of each run in a file, in order."""
    for seed, pieces in groupby(_pieces(path), key=itemgetter(0)):
        yield seed, pa.concat_tables(piece for _, piece in pieces)


def _pieces(path: Path) -> Rows:
    """Rows that follow each other in a file and are of one run and one row group."""
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as parquet:
            for group in range(parquet.num_row_groups):
                many = parquet.metadata.row_group(group).num_rows > FEW
                rows = parquet.read_row_group(group, use_threads=many).replace_schema_metadata(None)
                seeds = rows["seed"].to_numpy()
                starts = np.flatnonzero(np.diff(seeds, prepend=seeds[:1] - 1)).tolist()
                for start, end in zip(starts, [*starts[1:], len(seeds)], strict=True):
                    yield int(seeds[start]), rows.slice(start, end - start)
    except (OSError, pa.ArrowException) as error:
        raise StoreError(f"{path.name} cannot be read: {first_line(error)}") from error


def _groups(runs: Rows) -> Iterator[pa.Table]:
    """Runs put together to row groups."""
    waiting: list[pa.Table] = []
    count = size = 0
    for _, rows in runs:
        count, size = count + len(rows), size + rows.nbytes
        if waiting and (count > GROUP_ROWS or size > GROUP_BYTES):
            yield _together(waiting)
            waiting, count, size = [], len(rows), rows.nbytes
        waiting.append(rows)
    if waiting:
        yield _together(waiting)


def _together(tables: Sequence[pa.Table]) -> pa.Table:
    """One table in one piece, so that the writer makes one dictionary of its words."""
    return pa.concat_tables(tables).unify_dictionaries().combine_chunks()


def _same_bits(one: pa.Table, other: pa.Table) -> bool:
    """Whether two tables agree in every bit, NaNs included."""
    return one.schema.equals(other.schema) and all(
        _bits(a).equals(_bits(b)) for a, b in zip(one.columns, other.columns, strict=True)
    )


def _bits(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column as it can be compared: numbers as the integers of the same bits, words without their dictionaries."""
    if pa.types.is_fixed_size_list(column.type):
        column = pa.chunked_array([chunk.flatten() for chunk in column.chunks], column.type.value_type)
    if pa.types.is_dictionary(column.type):
        return column.cast(column.type.value_type)
    if pa.types.is_floating(column.type):
        return pa.chunked_array([chunk.view(pa.int64()) for chunk in column.chunks], pa.int64())
    return column
