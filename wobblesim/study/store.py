"""The results folder: a run is there if, and only if, a line of the manifest says so.

    config.yaml  manifest.jsonl  .lock  checkpoints/  .scratch/
    runs/ epochs/ trials/ behaviours/        condition=<id>/seed-<n>.parquet

A file is written beside the datasets, closed, its footer read back, flushed to the disk (fsync) and only then moved to
its place (`os.replace`); when all files of a run are in place, one flushed line of the manifest makes them a result.
Whatever dies in between leaves files that nothing refers to, and the run is computed again. The datasets hold Parquet
files only, so that other programs can open the folders as they are.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

import pyarrow as pa
import pyarrow.parquet as pq

from wobblesim.study.provenance import kernel_hash, provenance
from wobblesim.study.schema import SCHEMA_VERSION, encodings, flat

CHECKPOINTS, SCRATCH, MANIFEST, LOCK, CONFIG = "checkpoints", ".scratch", "manifest.jsonl", ".lock", "config.yaml"

LOCK_PATIENCE = 0.5
"""s to wait for a lock: a second writer is refused within a second."""

RunKey = tuple[str, int]
"""A condition's id and a seed."""


class StoreError(Exception):
    """The folder cannot be used as asked; the message is one sentence with its remedy."""


class WriteError(StoreError):
    """A result could not be written; what was committed before is untouched."""


# --- the manifest --------------------------------------------------------------------------------------------------


@dataclass
class Manifest:
    """What a folder holds.

    Attributes
    ----------
    conditions : dict
        By id, in the order in which they were added, what the condition is: ``{"config": ..., "kernel": ...}``.
    runs : dict
        By (condition id, seed), the line that committed the run.
    failures : dict
        By (condition id, seed), why a run came to no result; a later commit of the run removes it.
    unreadable : list of str
        Lines that say nothing, such as one cut off by a crash; their runs do not count.
    """

    conditions: dict[str, dict[str, Any]] = field(default_factory=dict)
    runs: dict[RunKey, dict[str, Any]] = field(default_factory=dict)
    failures: dict[RunKey, str] = field(default_factory=dict)
    unreadable: list[str] = field(default_factory=list)

    def take(self, line: Mapping[str, Any]) -> None:
        """Take in one line; KeyError or TypeError if it says nothing."""
        if line["kind"] == "condition":
            self.conditions[line["condition"]] = {"config": line["config"], "kernel": line["kernel"]}
        elif line["kind"] == "run":
            key = line["condition"], int(line["seed"])
            self.runs[key] = {name: line[name] for name in ("status", "diverged", "files")}
            self.runs[key]["refined"] = line.get("refined", 0)  # a line of schema version 1 has none
            self.failures.pop(key, None)
        elif line["kind"] == "failure":
            self.failures |= {(line["condition"], int(seed)): line["error"] for seed in line["seeds"]}
        else:
            raise KeyError(line["kind"])

    def files(self, table: str) -> list[str]:
        """Paths, relative to the folder, of a table's files: by condition, then seed."""
        order = {condition: place for place, condition in enumerate(self.conditions)}
        keys = sorted(self.runs, key=lambda key: (order.get(key[0], len(order)), key))
        return [self.runs[key]["files"][table]["path"] for key in keys if table in self.runs[key]["files"]]


def read_manifest(folder: Path) -> Manifest:
    """Read what a folder holds; one without a manifest holds nothing."""
    manifest = Manifest()
    path = folder / MANIFEST
    lines = path.read_bytes().split(b"\n") if path.exists() else []
    for number, line in enumerate(lines, start=1):
        last = number == len(lines)
        if last and not line:
            continue
        try:
            if last:
                raise ValueError("no end of line")
            manifest.take(json.loads(line))
        except (ValueError, KeyError, TypeError):
            cut = "cut off" if last else "damaged"
            manifest.unreadable.append(f"{path}, line {number}: {cut}, and ignored; what it named is computed again")
    return manifest


# --- writing -------------------------------------------------------------------------------------------------------


def write_atomically(path: Path, scratch: Path, write: Callable[[Path], None]) -> None:
    """Let `write` make a file, then move it to `path`: there is the whole new file or what was there before.

    Raises
    ------
    WriteError
        If the system refuses: no space, no permission, no folder.
    """
    temporary = scratch / f"{path.name}.{os.getpid()}"
    try:
        write(temporary)
        _flush(temporary)
        _make_folder(path.parent)
        temporary.replace(path)
        _flush(path.parent)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise _not_written(path, error) from error


def _not_written(path: Path, error: OSError) -> WriteError:
    return WriteError(f"cannot write {path}: {_reason(error)}; put that right and give the same command again")


def _reason(error: OSError | ValueError) -> str:
    return (getattr(error, "strerror", None) or str(error)).lower()


def _flush(path: Path) -> None:
    """Have the system put a file, or the names in a folder, on the disk (fsync)."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _make_folder(folder: Path) -> None:
    """Make a folder whose name survives a power cut."""
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        _flush(folder.parent)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _write_table(path: Path, table: pa.Table, about: Mapping[str, str]) -> None:
    """Write a Parquet file and read its footer back."""
    metadata = {f"wobblesim.{name}": value for name, value in about.items()}
    pq.write_table(
        table.replace_schema_metadata(metadata),
        path,
        compression="zstd",
        compression_level=3,
        write_page_checksum=True,
        **encodings(table.schema),
    )
    written = pq.read_metadata(path).num_rows
    if written != table.num_rows:
        raise OSError(f"{written} of {table.num_rows} rows arrived")


def read_tables(folder: Path, paths: Sequence[str], columns: Sequence[str] | None = None) -> pa.Table:
    """Read files of one table, those columns only, checking the checksum of each page.

    Raises
    ------
    StoreError
        If a file is missing, cut or altered.
    """
    parts = []
    for path in paths:
        try:
            # A third of the time of `pq.read_table`, which looks at folders first: 0.5 ms a file.
            with pq.ParquetFile(folder / path, page_checksum_verification=True) as file:
                parts.append(file.read(columns=columns).replace_schema_metadata(None))
        except (OSError, pa.ArrowException) as error:
            raise StoreError(
                f"{folder / path} is missing or damaged ({_first_line(error)}); "
                "remove it and give the sweep command again to compute it anew"
            ) from error
    whole = pa.concat_tables(parts)
    if lacking := [name for name in columns or () if name not in whole.column_names]:
        raise StoreError(f"{folder} is of an older version: its tables have no {', '.join(lacking)}")
    return whole


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]


# --- the folder ----------------------------------------------------------------------------------------------------


@dataclass
class Store:
    """The results folder of a sweep, held by this process; made by `opened`.

    Attributes
    ----------
    folder : Path
    manifest : Manifest
        Kept up to date by the methods below.
    lost : list of str
        Runs of the manifest whose files are gone or of another size: they do not count, and are computed again.
    """

    folder: Path
    manifest: Manifest
    lost: list[str] = field(default_factory=list)

    def present(self) -> set[RunKey]:
        """The runs that are there."""
        return set(self.manifest.runs)

    def differences(self, conditions: Mapping[str, dict[str, Any]]) -> list[str]:
        """How conditions, settings by id, differ from those of the same id in the folder: one sentence each."""
        found = []
        for condition in conditions.keys() & self._used():
            stored = self.manifest.conditions[condition]
            old = flat(stored["config"]) | {"kernel": stored["kernel"]}
            new = flat(_as_stored(conditions[condition])) | {"kernel": kernel_hash()}
            found += [
                f"{condition}: {key} is {_written(old, key)} there and {_written(new, key)} here"
                for key in (old | new)
                if old.get(key) != new.get(key)
            ]
        return sorted(found)

    def check(self, conditions: Mapping[str, dict[str, Any]]) -> None:
        """Compare conditions, settings by id, with what the folder holds.

        Raises
        ------
        StoreError
            If it has results of a condition of the same id and other settings, or of another simulator.
        """
        if differences := self.differences(conditions):
            raise StoreError(
                f"{self.folder} holds results of other settings or another simulator (kernel); "
                "choose another --out or undo the change: " + _shortened(differences)
            )

    def declare(self, conditions: Mapping[str, dict[str, Any]]) -> None:
        """Check conditions, and say what they are before there are runs of them."""
        self.check(conditions)
        used = self._used()
        for condition, config in conditions.items():
            what = {"config": _as_stored(config), "kernel": kernel_hash()}
            if condition not in used and self.manifest.conditions.get(condition) != what:
                _check_name(condition)
                self._append({"kind": "condition", "condition": condition, **what})

    def _used(self) -> set[str]:
        """The conditions of which there is work; one of which there is none may still become something else."""
        begun = {place.name.removeprefix("condition=") for place in (self.folder / CHECKPOINTS).glob("condition=*")}
        return (begun | {condition for condition, _ in self.manifest.runs}) & self.manifest.conditions.keys()

    def write_config(self, text: str) -> None:
        """Keep the configuration of the sweep beside its results."""
        write_atomically(
            self.folder / CONFIG, self.folder / SCRATCH, lambda path: _ignore(path.write_text(text, encoding="utf-8"))
        )

    def commit(self, run: RunKey, tables: Mapping[str, pa.Table]) -> None:
        """Make the tables of a run a result.

        Parameters
        ----------
        run : (str, int)
            Condition id and seed.
        tables : mapping
            By name; one row of "runs" among them.
        """
        files = {name: self._write(name, run, table) for name, table in tables.items()}
        condition, seed = run
        # Repeated here so that `wobblesim status` need not open a file for each run.
        told = tables["runs"].select(["status", "diverged", "refined"]).to_pylist()[0]
        line = {"kind": "run", "condition": condition, "seed": seed, **told, "files": files}
        self._append(line | {"written": datetime.now(UTC).isoformat(timespec="seconds")})

    def fail(self, condition: str, seeds: Sequence[int], error: str) -> None:
        """Note that runs came to no result, and why; the same command tries them again."""
        self._append({"kind": "failure", "condition": condition, "seeds": list(seeds), "error": error})

    def _write(self, name: str, run: RunKey, table: pa.Table) -> dict[str, Any]:
        condition, seed = run
        relative = Path(name, f"condition={condition}", f"seed-{seed}.parquet")
        path = self.folder / relative
        about = self._about(name, run)
        write_atomically(path, self.folder / SCRATCH, lambda temporary: _write_table(temporary, table, about))
        return {
            "path": relative.as_posix(),
            "rows": table.num_rows,
            "bytes": path.stat().st_size,
            "sha256": _sha256(path),
        }

    def _about(self, name: str, run: RunKey) -> dict[str, str]:
        condition, seed = run
        config = json.dumps(self.manifest.conditions[condition]["config"])
        about = {"schema_version": str(SCHEMA_VERSION), "table": name, "condition": condition, "seed": str(seed)}
        return about | {"config": config} | provenance()

    def _append(self, line: dict[str, Any]) -> None:
        """Add a line to the manifest; it is on the disk when this returns."""
        path = self.folder / MANIFEST
        is_new = not path.exists()
        try:
            with path.open("ab") as file:
                file.write(json.dumps(line).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
            if is_new:
                _flush(self.folder)
        except OSError as error:
            raise _not_written(path, error) from error
        self.manifest.take(line)


def _as_stored(config: dict[str, Any]) -> dict[str, Any]:
    """The settings as they come back from the manifest: lists instead of tuples."""
    return json.loads(json.dumps(config))


def _written(leaves: Mapping[str, Any], key: str) -> str:
    text = json.dumps(leaves[key]) if key in leaves else "absent"
    return text if len(text) <= 60 else f"{text[:40]}... ({len(text)} characters)"


def _shortened(sentences: Sequence[str], most: int = 5) -> str:
    more = f"; and {len(sentences) - most} more" if len(sentences) > most else ""
    return "; ".join(sentences[:most]) + more


def _check_name(condition: str) -> None:
    """Refuse an id that would leave its folder, or that a reader of the folder's name would take for a number."""
    if not condition or condition in (".", "..") or any(sign in condition for sign in "/\\\0") or condition.isdigit():
        raise StoreError(f"{condition!r} cannot be the id of a condition; begin it with a letter")


def _ignore(_: object) -> None:
    """Turn the result of a call into none."""


@contextmanager
def opened(folder: Path) -> Iterator[Store]:
    """Hold a results folder, made if need be: no other process can write to it meanwhile.

    Raises
    ------
    StoreError
        If it cannot be written to, or if another process holds it.
    """
    with _held(folder):
        manifest = read_manifest(folder)
        _cut_torn_line(folder / MANIFEST)
        store = Store(folder, manifest)
        _drop_lost(store)
        yield store


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. The system drops it with the process, however that ends: no file to remove by hand."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("a+", encoding="utf-8")
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _unwritable(folder, error) from error
    with lock:
        _take_lock(folder, lock)
        try:
            _prove_writable(folder)
        except OSError as error:
            raise _unwritable(folder, error) from error
        yield


def _unwritable(folder: Path, error: OSError | ValueError) -> StoreError:
    return StoreError(f"cannot write to {folder}: {_reason(error)}; choose another folder with --out")


def _take_lock(folder: Path, lock: TextIO) -> None:
    try:
        _lock_within(lock, LOCK_PATIENCE)
    except BlockingIOError:
        raise StoreError(
            f"{folder} is in use by {_holder(lock)}; wait for it to end or choose another folder with --out"
        ) from None
    except OSError as error:
        raise _unwritable(folder, error) from error
    lock.truncate(0)
    lock.write(f"process {os.getpid()} on {socket.gethostname()}")
    lock.flush()


def _lock_within(lock: TextIO, seconds: float) -> None:
    """Lock a file, also if somebody who asks who holds it holds it for an instant."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            return fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def _holder(lock: TextIO) -> str:
    lock.seek(0)
    return lock.read(200).strip() or "another process"


def holder(folder: Path) -> str | None:
    """Who is writing to a folder now, such as ``process 12 on host``; None if nobody is."""
    path = folder / LOCK
    if not path.exists():
        return None
    with path.open("r", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return _holder(lock)
    return None


def _prove_writable(folder: Path) -> None:
    """Make the scratch folder anew, empty of what an earlier crash left, and write to it."""
    scratch = folder / SCRATCH
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    probe = scratch / "probe"
    probe.write_bytes(bytes(1))
    probe.unlink()


def _cut_torn_line(manifest: Path) -> None:
    """Cut off what follows the last end of line, or the next line would be glued to it."""
    if manifest.exists():
        content = manifest.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.truncate(manifest, whole)


def _drop_lost(store: Store) -> None:
    """Count no run whose files are gone or cut."""
    for run, line in list(store.manifest.runs.items()):
        for file in line["files"].values():
            path = store.folder / file["path"]
            if not path.is_file() or path.stat().st_size != file["bytes"]:
                store.lost.append(f"{path} is missing or cut; its run is computed again")
                store.manifest.runs.pop(run, None)
