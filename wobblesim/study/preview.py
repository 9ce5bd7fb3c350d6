"""What a sweep would do, from the configuration and the results folder alone; nothing is written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wobblesim.config import SweepConfig
from wobblesim.study import resume
from wobblesim.study.group import Group
from wobblesim.study.lock import Shard
from wobblesim.study.manifest import Manifest, read_manifest
from wobblesim.study.plan import Plan, Study, lane_steps, lengths, plan, study
from wobblesim.study.store import Store


@dataclass(frozen=True)
class Preview:
    """What a sweep, or a shard of it, finds and would do.

    Attributes
    ----------
    study : Study
    plan : Plan
    present : mapping of str to int
        Runs that are there, by condition.
    epochs : mapping of Group to int
        Epochs done of the groups begun.
    """

    study: Study
    plan: Plan
    present: Mapping[str, int]
    epochs: Mapping[Group, int]

    def groups(self) -> Iterator[tuple[str, int, int, int]]:
        """Condition, seeds, epochs done, and how many groups are alike in this, for all groups."""
        for group, epoch in self.epochs.items():
            yield group.condition, len(group.seeds), epoch, 1
        for condition, seeds in self.plan.missing.items():
            for seeds_of_group, times in lengths(len(seeds), self.plan.size):
                yield condition, seeds_of_group, 0, times

    def rows(self) -> list[dict[str, Any]]:
        """One row a condition: runs ``wanted``, ``present``, ``missing``, and the ``lane_steps`` left, at most."""
        left = Counter[str]()
        for condition, seeds, epoch, times in self.groups():
            left[condition] += times * seeds * lane_steps(self.study.setups[condition], epoch)
        rows = []
        for condition in self.study.conditions:
            wanted, present = len(self.study.seeds_of(condition)), self.present.get(condition, 0)
            runs = {"wanted": wanted, "present": present, "missing": wanted - present}
            rows.append({"condition": condition, **runs, "lane_steps": left[condition]})
        return rows


def preview(
    config: SweepConfig, folder: Path, shard: Shard | None = None, workers: int = 1, threads: int = 1
) -> Preview:
    """Look ahead.

    Parameters
    ----------
    config : SweepConfig
    folder : Path
        Of the results; it need not be there.
    shard : Shard, optional
        Whose part to look at.
    workers, threads : int
        As for `plan`.

    Raises
    ------
    PlanError
        If a condition cannot be run.
    StoreError
        If the folder holds results of other settings.
    """
    whole = study(config)
    mine = whole.shard(shard.number, shard.count) if shard else whole
    manifest = read_manifest(folder)
    Store(folder, manifest).check(whole.written)
    epochs = _begun(folder, manifest, mine)
    todo = plan(mine, manifest.runs.keys(), epochs.keys(), workers, threads)
    return Preview(mine, todo, Counter(run[0] for run in manifest.runs if mine.asks_for(run)), epochs)


def _begun(folder: Path, manifest: Manifest, wanted: Study) -> dict[Group, int]:
    """The groups that a sweep would go on with, and how many epochs of each are done."""
    heads = [
        head
        for condition, what in manifest.conditions.items()
        for head in resume.standing(folder, condition)
        if head.identity == resume.identity(what)
    ]
    epochs = {head.group: head.epoch for head in heads}
    chosen = resume.useful(epochs.keys(), wanted.asks_for, manifest.runs.keys())
    return {group: epochs[group] for group in chosen}
