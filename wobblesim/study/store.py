"""The results folder, held by this process.

    config.yaml  manifest.jsonl  .lock  checkpoints/  quarantine/  .scratch/
    runs/ epochs/ trials/ behaviours/        condition=<id>/seed-<n>.parquet

A file is written beside the datasets, flushed to the disk (fsync) and only then moved to its place (`os.replace`); when
all files of a run are in place, one flushed line of the manifest makes them a result. Whatever dies in between leaves
files that nothing refers to: they are put into quarantine, and the run is computed again. The datasets hold Parquet
files only, so that other programs can open the folders as they are.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from wobblesim.study.errors import StoreError, not_written, unwritable
from wobblesim.study.files import FileRecord, flush, move_all, write_atomically, write_table
from wobblesim.study.lock import Shard, held
from wobblesim.study.manifest import (
    MANIFEST,
    OF_DATASET,
    Manifest,
    RunKey,
    Writer,
    manifests,
    packed,
    read_lines,
    read_manifest,
)
from wobblesim.study.provenance import kernel_hash, provenance
from wobblesim.study.schema import COLUMNS, SCHEMA_VERSION, flat

CHECKPOINTS, SCRATCH, QUARANTINE, CONFIG = "checkpoints", ".scratch", "quarantine", "config.yaml"


# --- a worker's part: files that are not results yet ---------------------------------------------------------------


def attempt(scratch: Path) -> Path:
    """A new folder for the files of one attempt at a job: another one, elsewhere, cannot touch them.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    folder = scratch / f"{os.getpid()}-{uuid.uuid4().hex[:12]}"
    try:
        folder.mkdir()
    except OSError as error:
        raise not_written(folder, error) from error
    return folder


def stage(scratch: Path, run: RunKey, tables: Mapping[str, pa.Table], config: str) -> dict[str, Any]:
    """Write the tables of a run into a scratch folder; return the line that will make them a result.

    Parameters
    ----------
    scratch : Path
        Of this attempt alone.
    run : (str, int)
        Condition id and seed.
    tables : mapping
        By name; one row of "runs" among them.
    config : str
        The settings of the condition, as JSON.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    condition, seed = run
    about = {"schema_version": str(SCHEMA_VERSION), "condition": condition, "seed": str(seed), "config": config}
    about |= provenance()
    files = {}
    for name, table in tables.items():
        staged = scratch / f"{name}-{seed}.parquet"
        length, sha256 = write_table(staged, table, {"table": name, **about})
        path = f"{name}/condition={condition}/seed-{seed}.parquet"
        files[name] = FileRecord(path, table.num_rows, length, sha256)._asdict() | {"staged": str(staged)}
    # Repeated here so that `wobblesim status` need not open a file for each run.
    told = {name: tables["runs"][name][0].as_py() for name in ("status", "diverged", "refined")}
    written = datetime.now(UTC).isoformat(timespec="seconds")
    return {"kind": "run", "condition": condition, "seed": seed, **told, "files": files, "written": written}


# --- the folder ----------------------------------------------------------------------------------------------------


@dataclass
class Store:
    """The results folder of a sweep, or a shard's part of it, held by this process; made by `opened`.

    Attributes
    ----------
    folder : Path
    manifest : Manifest
        Kept up to date by the methods below.
    shard : Shard or None
    lost : list of str
        Runs of the manifest whose files are gone or of another size, and files of no run: they do not count.
    """

    folder: Path
    manifest: Manifest
    shard: Shard | None = None
    lost: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._writer: Writer | None = None
        self._gone: set[RunKey] = set()  # runs of the manifest that do not count

    @property
    def scratch(self) -> Path:
        """Where this writer's files are made."""
        return self.folder / SCRATCH / str(self.shard or "all")

    def differences(self, conditions: Mapping[str, dict[str, Any]]) -> list[Difference]:
        """How conditions, settings by id as JSON has them, differ from those of the same id in the folder."""
        found: dict[tuple[str, str, str], list[str]] = {}
        used, kernel = self._used(), kernel_hash()
        for condition in [name for name in conditions if name in used]:
            stored, what = self.manifest.conditions[condition], {"config": conditions[condition], "kernel": kernel}
            if stored == what:
                continue
            old = flat(stored["config"]) | {"kernel": stored["kernel"]}
            new = flat(what["config"]) | {"kernel": kernel}
            for key in old | new:
                if old.get(key) != new.get(key):
                    found.setdefault((key, _written(old, key), _written(new, key)), []).append(condition)
        return [Difference(*what, tuple(where)) for what, where in found.items()]

    def check(self, conditions: Mapping[str, dict[str, Any]]) -> None:
        """Compare conditions, settings by id, with what the folder holds.

        Raises
        ------
        StoreError
            If it has results of a condition of the same id and other settings, or of another simulator.
        """
        if differences := self.differences(conditions):
            raise StoreError(
                f"{self.folder} holds results of other settings or of another simulator:\n"
                f"{_as_table(differences, len(conditions))}\n"
                "Undo the change, or give --fork DIR to start a folder beside it that takes over what is unchanged."
            )

    def declare(self, conditions: Mapping[str, dict[str, Any]], seeds: Sequence[int], config: str) -> None:
        """Check conditions, and say what they are, and what is wanted of them, before there are runs of them.

        Parameters
        ----------
        conditions : mapping
            Settings by id, as JSON has them (lists, no tuples).
        seeds : sequence of int
        config : str
            Text of the configuration, kept beside the results.
        """
        self.check(conditions)
        used, kernel = self._used(), kernel_hash()
        lines: list[dict[str, Any]] = []
        for condition, settings in conditions.items():
            what = {"config": settings, "kernel": kernel}
            if condition not in used and self.manifest.conditions.get(condition) != what:
                _check_name(condition)
                lines.append({"kind": "condition", "condition": condition, **what})
        sha256 = hashlib.sha256(config.encode()).hexdigest()
        wanted = list(conditions), tuple(seeds)
        if wanted not in self.manifest.studies or sha256 not in self.manifest.configs:
            lines.append({"kind": "study", "conditions": wanted[0], "seeds": packed(seeds), "config": sha256})
        self._append(lines)
        write_atomically(self.folder / CONFIG, self.scratch, config.encode())

    def _used(self) -> set[str]:
        """The conditions of which there is work; one of which there is none may still become something else."""
        begun = {place.name.removeprefix("condition=") for place in (self.folder / CHECKPOINTS).glob("condition=*")}
        return (begun | {condition for condition, _ in self.manifest.runs}) & self.manifest.conditions.keys()

    def commit(self, lines: Sequence[Mapping[str, Any]]) -> None:
        """Make staged runs results.

        Parameters
        ----------
        lines : sequence of mapping
            Of `stage`.

        Raises
        ------
        WriteError
            If the system refuses; what was committed before is untouched.
        """
        files = [file for line in lines for file in line["files"].values()]
        self._append(self._forgotten(lines))
        move_all((Path(file["staged"]), self.folder / file["path"]) for file in files)
        self._append([_without_staging(line) for line in lines])
        for attempt in {Path(file["staged"]).parent for file in files}:
            shutil.rmtree(attempt, ignore_errors=True)

    def forget(self, run: RunKey) -> None:
        """Count a run no longer, whose files are lost."""
        del self.manifest.runs[run]
        self._gone.add(run)

    def _forgotten(self, lines: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Lines that take back what older ones say of the same runs, whose files are lost.

        The new files may be as long as the old ones: without this, a death before their line would leave them under an
        old line that tells of others.
        """
        runs = ((line["condition"], [row[0] for row in line.get("runs", ())] or [line["seed"]]) for line in lines)
        again = ((condition, [seed for seed in seeds if (condition, seed) in self._gone]) for condition, seeds in runs)
        return [{"kind": "lost", "condition": condition, "seeds": seeds} for condition, seeds in again if seeds]

    def fail(self, condition: str, seeds: Sequence[int], error: str) -> None:
        """Note that runs came to no result, and why; the same command tries them again."""
        self._append([{"kind": "failure", "condition": condition, "seeds": list(seeds), "error": error}])

    def _append(self, lines: Sequence[Mapping[str, Any]]) -> None:
        if lines:
            if self._writer is None:
                name = f"manifest-{self.shard}.jsonl" if self.shard else MANIFEST
                self._writer = Writer(self.folder / name)
            self._writer.append(lines)
            for line in lines:
                self.manifest.take(line)

    def take_in_shards(self) -> None:
        """Write what shards have done into the manifest of the whole folder, and remove theirs."""
        for path in manifests(self.folder):
            if path.name != MANIFEST:
                lines = [line.content for line in read_lines(path) if line.content]
                self._append([{key: line[key] for key in line if key not in ("after", "check")} for line in lines])
                path.unlink()
                flush(self.folder)  # taken in again later, its lines would undo what comes after them


def _check_name(condition: str) -> None:
    """Refuse an id that would leave its folder, or that a reader of the folder's name would take for a number."""
    if not condition or condition in (".", "..") or any(sign in condition for sign in "/\\\0") or condition.isdigit():
        raise StoreError(f"{condition!r} cannot be the id of a condition; begin it with a letter")


def as_stored(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings as they come back from the manifest: lists instead of tuples."""
    return json.loads(json.dumps(settings))


def _without_staging(line: Mapping[str, Any]) -> dict[str, Any]:
    files = {name: {key: file[key] for key in FileRecord._fields} for name, file in line["files"].items()}
    return {**line, "files": files}


# --- what differs --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """A setting that conditions have in the folder and in the configuration, each in words."""

    key: str
    there: str
    here: str
    conditions: tuple[str, ...]


def _written(leaves: Mapping[str, Any], key: str) -> str:
    text = json.dumps(leaves[key]) if key in leaves else "absent"
    return text if len(text) <= 60 else f"{text[:40]}... ({len(text)} characters)"


def _as_table(differences: Sequence[Difference], conditions: int, most: int = 12) -> str:
    """One row a setting that differs."""
    title = ("setting", "there", "here", "")
    shown = differences[:most]
    rows = [title, *((it.key, it.there, it.here, _in_conditions(it.conditions, conditions)) for it in shown)]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = ["  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    if len(differences) > most:
        lines.append(f"  and {len(differences) - most} more")
    return "\n".join(line.rstrip() for line in lines)


def _in_conditions(names: Sequence[str], of: int) -> str:
    if len(names) == of > 1:
        return f"in all {of:,} conditions"
    others = f" and {len(names) - 2:,} more" if len(names) > 2 else ""
    return f"in {', '.join(names[:2])}{others}"


# --- opening -------------------------------------------------------------------------------------------------------


@contextmanager
def opened(folder: Path, shard: Shard | None = None, study: str = "") -> Iterator[Store]:
    """Hold a results folder, made if need be, or a shard's part of it: no other process can write to it meanwhile.

    Parameters
    ----------
    folder : Path
    shard : Shard, optional
    study : str
        As for `held`.

    Raises
    ------
    StoreError
        If it cannot be written to, or if another process holds it.
    """
    with held(folder, shard, study):
        store = Store(folder, read_manifest(folder), shard)
        try:
            _prove_writable(store.folder / SCRATCH if shard is None else store.scratch, store.scratch)
            if shard is None:
                store.take_in_shards()
            _set_aside_lost(store)
        except OSError as error:
            raise unwritable(folder, error) from error
        yield store


def _prove_writable(old: Path, new: Path) -> None:
    """Make the scratch folder anew, empty of what an earlier crash left, and write to it."""
    shutil.rmtree(old, ignore_errors=True)
    new.mkdir(parents=True, exist_ok=True)
    probe = new / "probe"
    probe.write_bytes(bytes(1))
    probe.unlink()


def _set_aside_lost(store: Store) -> None:
    """Count no run whose files are gone or cut; put cut files, and files of no run, into quarantine.

    A shard leaves alone what may be another's: it only counts.
    """
    there = dict(_dataset_files(store.folder))
    known = store.manifest.every_file()
    for path in _datasets_outside(store.folder):
        raise StoreError(f"{path} leads out of {store.folder}; remove that link")
    bad = {path: _fault(file, there.get(path)) for path, file in known.items() if there.get(path) != file.bytes}
    store.lost += [f"{store.folder / path} {fault}; its runs are computed again" for path, fault in bad.items()]
    for run, what in list(store.manifest.runs.items()):
        if any(file.path in bad for file in what.files.values()):
            store.forget(run)
    if store.shard is None:
        kept = store.manifest.every_file()
        for path in there.keys() - kept.keys():
            if OF_DATASET.fullmatch(path):
                store.lost += [f"{store.folder / path} belongs to no run; it is in {QUARANTINE} now"] * (
                    path not in known
                )
                _put_aside(store.folder, path)


def _fault(file: FileRecord, length: int | None) -> str:
    return (
        "is missing" if length is None else f"has {length:,} bytes instead of {file.bytes:,}; it is in {QUARANTINE} now"
    )


def _dataset_files(folder: Path) -> Iterator[tuple[str, int]]:
    """Relative path and length of every file in the datasets."""
    for table in COLUMNS:
        for condition in _entries(folder / table):
            if condition.is_dir(follow_symlinks=False):
                for entry in _entries(Path(condition.path)):
                    if entry.is_file():
                        yield f"{table}/{condition.name}/{entry.name}", entry.stat().st_size
            else:
                yield f"{table}/{condition.name}", condition.stat(follow_symlinks=False).st_size


def _entries(folder: Path) -> Iterable[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return sorted(entries, key=lambda entry: entry.name)
    except FileNotFoundError:
        return ()


def _datasets_outside(folder: Path) -> Iterator[Path]:
    """Folders of datasets that are links: what is written there lands elsewhere."""
    for table in COLUMNS:
        if (folder / table).is_symlink():
            yield folder / table
        yield from (Path(entry.path) for entry in _entries(folder / table) if entry.is_symlink())


def _put_aside(folder: Path, path: str) -> None:
    """Move a file into quarantine, where nothing is read; an older one of the same name goes."""
    aside = folder / QUARANTINE / path
    aside.parent.mkdir(parents=True, exist_ok=True)
    (folder / path).replace(aside)
