"""What is not sound is put aside, so that the rest can be used and the sweep command computes the lost runs anew."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wobblesim.study import resume
from wobblesim.study.errors import StoreError, not_written
from wobblesim.study.files import move_all, write_atomically
from wobblesim.study.manifest import MANIFEST, UNREADABLE, Manifest, manifests, read_lines, read_manifest, sealed_all
from wobblesim.study.store import CONFIG, QUARANTINE, Store, opened
from wobblesim.study.verify import Inspection, Look, Tell, Verified


@dataclass(frozen=True)
class Repaired:
    """What came of repairing a folder.

    Attributes
    ----------
    before, after : Verified
    done : tuple of str
        What was done, a sentence each.
    missing : int
        Runs that were asked for and are not there: the sweep command, given again, computes them.
    """

    before: Verified
    after: Verified
    done: tuple[str, ...]
    missing: int


def repair(folder: Path, tell: Tell | None = None) -> Repaired:
    """Put what is not sound into quarantine, and have the manifest name only what is.

    Raises
    ------
    StoreError
        If it is no folder of results, or if somebody else writes to it.
    WriteError
        If the system refuses.
    """
    inspection = Inspection(folder, tell)
    before = inspection.verdict(patience=0.0)
    if not before.findings and not before.pending:
        return Repaired(before, before, (), 0)
    if not manifests(folder):
        raise StoreError(
            f"{folder} has lost its {MANIFEST}, without which nobody knows what is sound; put it back first"
        )
    wanted = {(name, seed) for name, seeds in inspection.look().manifest.wanted().items() for seed in seeds}
    with opened(folder) as store:
        done = [*store.lost, *_mend(store, inspection.look())]
    missing = wanted - read_manifest(folder).runs.keys()
    return Repaired(before, inspection.verdict(), tuple(done), len(missing))


def _mend(store: Store, seen: Look) -> Iterator[str]:
    """Do what there is to do in a folder that is held; say it in a sentence each."""
    named = seen.manifest.every_file().keys()
    lost = seen.lost | (seen.manifest.runs.keys() - store.manifest.runs.keys())
    for run in lost:
        del seen.manifest.runs[run]
    if lost or seen.manifest.faults:
        yield from _write_manifest(store, seen.manifest)
    aside = {*(named - seen.manifest.every_file().keys()), *seen.strangers}
    if any(finding.path == CONFIG for finding in seen.others):
        aside.add(CONFIG)
    there = sorted(path for path in aside if os.path.lexists(store.folder / path))
    move_all((store.folder / path, store.folder / QUARANTINE / path) for path in there)
    yield from (f"{path} is in {QUARANTINE} now" for path in there)
    yield from resume.sweep_up(store.folder)


def _write_manifest(store: Store, manifest: Manifest) -> Iterator[str]:
    """Write the lines anew that say something that still holds; the old ones go into quarantine."""
    path, aside = store.folder / MANIFEST, store.folder / QUARANTINE / MANIFEST
    try:
        aside.parent.mkdir(exist_ok=True)
        shutil.copyfile(path, aside)
    except OSError as error:
        raise not_written(aside, error) from error
    content, _ = sealed_all(_lines(path, manifest))
    write_atomically(path, store.scratch, content)
    yield f"{MANIFEST} is written anew; what it was is in {QUARANTINE}"


def _lines(path: Path, manifest: Manifest) -> Iterator[dict[str, Any]]:
    """The lines of a manifest that can be trusted, of runs only if they are those that `manifest` has."""
    conditions = dict(manifest.conditions)
    for line in read_lines(path):
        said = Manifest()
        try:
            if line.content is None:
                continue
            said.take(line.content)
        except UNREADABLE:
            continue
        for condition in said.conditions:
            conditions.pop(condition, None)
        kept = {seed for (condition, seed), run in said.runs.items() if manifest.runs.get((condition, seed)) == run}
        if (said.runs and not kept) or line.content["kind"] == "lost":
            continue  # what it named is not kept
        content = {key: value for key, value in line.content.items() if key not in ("after", "check")}
        if content["kind"] == "compact":
            content["runs"] = [run for run in content["runs"] if int(run[0]) in kept]
        yield content
    for condition, what in conditions.items():  # their lines are lost
        yield {"kind": "condition", "condition": condition, **what}
