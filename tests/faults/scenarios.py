"""What a process does to a results folder, in pieces short enough to be broken off at every call."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from faults.disk import Disk
from study.toy import TABLES, StopAfter, as_bytes, study, toy

from wobblesim.config import SweepConfig
from wobblesim.physics.simulate import Trials
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import Outcome, sweep
from wobblesim.study.files import FileRecord, damage, read_tables
from wobblesim.study.lock import Shard
from wobblesim.study.manifest import MANIFEST, RunKey, read_manifest
from wobblesim.study.progress import Progress
from wobblesim.study.store import CHECKPOINTS, SCRATCH
from wobblesim.study.work import Interval

FIXED = "conditions={fixed: {wobble: null}}"
SMALL = ("learning.epochs=2", "learning.population=4", "learning.parents=2", "log=epochs")

RESULTS = "results"
"""The folder that a scenario ends with, below that of the scenario."""


def small(*settings: str, seeds: str = "0..1") -> SweepConfig:
    """One group of two runs, of two files each."""
    return study(*SMALL, FIXED, *settings, seeds=seeds)


EPOCHS = [0]
"""How many epochs were computed."""


def counted(*arguments: Any, **settings: Any) -> Trials:
    """The toy task, counted."""
    EPOCHS[0] += 1
    return toy(*arguments, **settings)


def go_on(folder: Path, config: SweepConfig, **options: Any) -> Outcome:
    """The command that is given again."""
    return sweep(config, folder / RESULTS, simulate=counted, **options)


@dataclass(frozen=True)
class Scenario:
    """A piece of work on a folder.

    Attributes
    ----------
    name : str
    prepare : callable
        Makes what is there before, in a folder.
    act : callable
        Called with that folder and a listener for progress; what is to be broken off.
    finish : callable
        Called with that folder: what a user then does.
    cost : int or None
        Epochs that are computed twice at most; None if checkpoints play no part.
    """

    name: str
    prepare: Callable[[Path], object]
    act: Callable[[Path, Callable[[Progress], None]], object]
    finish: Callable[[Path], object]
    cost: int | None = None


def _simple(
    name: str, config: SweepConfig, prepare: Callable[[Path], object], cost: int | None = None, **options: Any
) -> Scenario:
    def act(folder: Path, heard: Callable[[Progress], None]) -> object:
        return go_on(folder, config, progress=heard, **options)

    return Scenario(name, prepare, act, lambda folder: go_on(folder, config, **options), cost)


def _nothing(folder: Path) -> None:
    pass


def _both_shards(folder: Path) -> None:
    for number in (1, 2):
        go_on(folder, small(), shard=Shard(number, 2))


def _after_a_shard(folder: Path) -> None:
    _both_shards(folder)
    go_on(folder, small())


def _shard(folder: Path, heard: Callable[[Progress], None]) -> object:
    return go_on(folder, small(), shard=Shard(1, 2), progress=heard)


def _broken(folder: Path) -> None:
    """What an earlier death and a bad disk have left: recovery itself is broken off."""
    go_on(folder, small())
    results = folder / RESULTS
    manifest = results / MANIFEST
    manifest.write_bytes(manifest.read_bytes()[:-20])
    (cut,) = results.glob("epochs/*/seed-0.parquet")
    cut.write_bytes(cut.read_bytes()[:100])
    (results / SCRATCH / "all" / "1-abc").mkdir()
    (results / SCRATCH / "all" / "1-abc" / "runs-0.parquet").write_bytes(b"begun")


def _without_links(scenario: Scenario) -> Scenario:
    def act(folder: Path, heard: Callable[[Progress], None]) -> object:
        with mock.patch.object(os, "link", side_effect=OSError(1, "no links here")):
            return scenario.act(folder, heard)

    return Scenario(f"{scenario.name} by copies", scenario.prepare, act, scenario.finish)


def _fork() -> Scenario:
    def prepare(folder: Path) -> object:
        return sweep(small(), folder / "origin", simulate=toy)

    def go(folder: Path, heard: Callable[[Progress], None] | None = None) -> object:
        return go_on(folder, small(), fork_of=folder / "origin", progress=heard)

    return Scenario("fork", prepare, go, go)


SCENARIOS = [
    _simple("commit", small(), _nothing),
    _simple("checkpoints", small("learning.epochs=3", seeds="0"), _nothing, 1, checkpoint=Interval(seconds=0.0)),
    _simple("go on", small(), lambda folder: go_on(folder, small(), stop=StopAfter(2))),
    _simple("declare more", small(), lambda folder: go_on(folder, small(seeds="0"))),
    Scenario("shard", _nothing, _shard, _after_a_shard),
    _simple("take in shards", small(), _both_shards),
    _fork(),
    _without_links(_fork()),
    _simple("recovery", small(), _broken),
]


def chosen(*names: str) -> list[Any]:
    """Scenarios of these names, as parameters of a test."""
    return [pytest.param(scenario, id=scenario.name) for scenario in SCENARIOS if scenario.name in names]


def all_but(*names: str) -> list[Any]:
    """All scenarios, as parameters of a fixture; these ones only in the tests at night."""
    return [
        pytest.param(scenario, id=scenario.name, marks=[pytest.mark.nightly] * (scenario.name in names))
        for scenario in SCENARIOS
    ]


READ: dict[tuple[FileRecord, str], bytes] = {}
"""What the reader has made of a file that the manifest told of, and of its bytes: the same again."""


def rows_of(folder: Path, file: FileRecord) -> bytes:
    """The rows of a file, but for the wall time; StoreError if the reader refuses it."""
    path = folder / file.path
    key = file, hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else ""
    if key not in READ:
        table = read_tables(folder, [file])
        READ[key] = as_bytes(table.select([name for name in table.column_names if name != "seconds"]))
    return READ[key]


def read(folder: Path) -> tuple[dict[str, bytes], set[RunKey]]:
    """The rows of each file of a results folder that the reader accepts, and the runs of which it accepts all files."""
    rows = {}
    manifest = read_manifest(folder)
    for path, file in manifest.every_file().items():
        with contextlib.suppress(StoreError):
            rows[path] = rows_of(folder, file)
    whole = {key for key, run in manifest.runs.items() if {file.path for file in run.files.values()} <= rows.keys()}
    return rows, whole


def check_sound(folder: Path, wanted: dict[str, bytes]) -> None:
    """Refuse a results folder that has other rows than those wanted, or anything of no use."""
    rows, whole = read(folder)
    manifest = read_manifest(folder)
    assert rows == wanted
    assert whole == manifest.runs.keys()
    assert manifest.failures == {}
    files = manifest.every_file()
    assert [damage(folder, file) for file in files.values()] == [None] * len(files)
    there = {str(path.relative_to(folder)) for table in TABLES for path in (folder / table).rglob("*.*")}
    assert there == files.keys()
    left = [path for name in (CHECKPOINTS, SCRATCH) for path in (folder / name).rglob("*") if path.is_file()]
    assert left == []


def note(disk: Disk, folder: Path, told: Progress) -> None:
    """Keep in mind what is there when a process says that something is."""
    if told.kind in ("begin", "run", "end"):
        with disk.aside():
            disk.mark(read(folder / RESULTS)[1])


def recorded(scenario: Scenario, folder: Path) -> tuple[Disk, dict[str, bytes]]:
    """The calls of a scenario that nothing disturbs, in a copy of the folder `origin`, and the rows in the end."""
    shutil.copytree(folder.parent / "origin", folder)
    with Disk(folder) as disk:
        scenario.act(folder, lambda told: note(disk, folder, told))
    scenario.finish(folder)
    return disk, read(folder / RESULTS)[0]


def check_recovers(scenario: Scenario, folder: Path, wanted: dict[str, bytes], there: set[RunKey]) -> None:
    """Refuse a folder with wrong rows or without certain runs, or one that the same command does not mend."""
    rows, whole = read(folder / RESULTS)
    assert rows.items() <= wanted.items()
    assert there <= whole
    scenario.finish(folder)
    check_sound(folder / RESULTS, wanted)
