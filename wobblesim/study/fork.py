"""A folder beside another: what is unchanged is taken over, the rest is computed anew."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wobblesim.study.errors import StoreError, not_written
from wobblesim.study.files import FileRecord, damage, flush
from wobblesim.study.manifest import MANIFEST, Manifest, RunKey, listed, read_manifest, told
from wobblesim.study.plan import Study
from wobblesim.study.store import Store, attempt

AT_A_TIME = 500
"""Lines committed together."""


def take_over(origin: Path, store: Store, study: Study) -> list[str]:
    """Take over the wanted runs of another folder whose conditions are the same; say so in a sentence.

    Files are linked where the file system can, else copied; a run whose files are damaged is left out.

    Raises
    ------
    StoreError
        If there is nothing in that folder, or it is the same one.
    WriteError
        If a file cannot be written.
    """
    if not (origin / MANIFEST).is_file():
        raise StoreError(f"{origin} holds no results to start beside; give the folder of a sweep to --out")
    if origin.resolve() == store.folder.resolve():
        raise StoreError(f"{origin} cannot start beside itself; give another folder to --fork")
    there = read_manifest(origin)
    same = {name for name in study.conditions if there.conditions.get(name) == store.manifest.conditions.get(name)}
    by_files: dict[tuple[FileRecord, ...], list[RunKey]] = {}
    for key, run in there.runs.items():
        by_files.setdefault(tuple(run.files.values()), []).append(key)
    present = store.manifest.runs
    whole = [  # files of which every run is wanted
        keys
        for keys in by_files.values()
        if keys[0][0] in same and all(study.asks_for(key) and key not in present for key in keys)
    ]
    taken = 0
    for start in range(0, len(whole), AT_A_TIME):
        scratch = attempt(store.scratch)
        lines = [
            line
            for number, keys in enumerate(whole[start : start + AT_A_TIME])
            if (line := _line(origin, scratch, there, keys, number))
        ]
        store.commit(lines)
        taken += sum(len(line["runs"]) if line["kind"] == "compact" else 1 for line in lines)
    return [f"{taken:,} of {study.n_runs:,} runs taken over from {origin}"]


def _line(origin: Path, scratch: Path, there: Manifest, keys: Sequence[RunKey], number: int) -> dict[str, Any] | None:
    """The line that commits runs that share files, those linked into a scratch folder; None if they are damaged."""
    condition, seed = keys[0]
    run = there.runs[keys[0]]
    if any(damage(origin, file) for file in run.files.values()):
        return None
    files = {
        table: file._asdict() | {"staged": _link(origin, file, scratch / f"{table}-{number}")}
        for table, file in run.files.items()
    }
    if Path(run.files["runs"].path).name.startswith("seed-"):
        return {"kind": "run", "condition": condition, "seed": seed, **told(run), "files": files}
    return {"kind": "compact", "condition": condition, "runs": listed(there, keys), "files": files}


def _link(origin: Path, file: FileRecord, target: Path) -> str:
    try:
        os.link(origin / file.path, target)
    except OSError:  # another file system, or one without links
        try:
            shutil.copyfile(origin / file.path, target)
            flush(target)
        except OSError as error:
            raise not_written(target, error) from error
    return str(target)
