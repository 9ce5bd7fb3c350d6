"""The stored tables as pandas frames, only the columns asked for."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd
import pyarrow as pa

from wobblesim.analysis import lineage
from wobblesim.study.errors import StoreError
from wobblesim.study.files import read_tables
from wobblesim.study.manifest import Manifest, manifests, read_manifest

MOST_NAMES = 8
"""Conditions that a message lists."""


@dataclass(frozen=True)
class Results:
    """The results in a folder; made by `load`. Each method reads its table anew.

    Rows come by condition, in the order of the study, then by seed, epoch and slot. `condition` is an ordered
    categorical.

    Attributes
    ----------
    folder : Path
    manifest : Manifest
        What was there when it was loaded.
    """

    folder: Path
    manifest: Manifest

    @property
    def conditions(self) -> list[str]:
        """Conditions that have a run, in the order of the study."""
        used = {condition for condition, _ in self.manifest.runs}
        return [condition for condition in self.manifest.conditions if condition in used]

    def seeds(self, condition: str | None = None) -> list[int]:
        """Seeds of the runs of a condition, or of all, in order."""
        return sorted({seed for name, seed in self.manifest.runs if condition in (None, name)})

    def require(self, condition: str | None = None, seed: int | None = None) -> None:
        """Refuse a condition, a seed, or a run of both, that is not there, with the nearest one that is.

        Raises
        ------
        StoreError
            If there is no finished run of the condition, or none with that seed.
        """
        if condition is not None and condition not in self.manifest.conditions:
            raise StoreError(f"{self.folder} has no condition {condition!r}; {_nearest(condition, self.conditions)}")
        seeds = self.seeds(condition)
        if not seeds:
            raise StoreError(
                f"{self.folder} has no finished run of {condition} yet; give the sweep command again to go on"
            )
        if seed is not None and seed not in seeds:
            nearest = min(seeds, key=lambda known: abs(known - seed))
            of = "" if condition is None else f" of {condition}"
            raise StoreError(f"{self.folder} has no run{of} with seed {seed}; the nearest is {nearest}")

    def runs(self, *columns: str) -> pd.DataFrame:
        """One row a run: result and settings."""
        return self._read("runs", columns)

    def epochs(self, *columns: str) -> pd.DataFrame:
        """One row an epoch of a run."""
        return self._read("epochs", columns)

    def trials(self, *columns: str) -> pd.DataFrame:
        """One row a trial; only of runs whose `log` asked for it."""
        return self._read("trials", columns)

    def behaviours(self, *columns: str) -> pd.DataFrame:
        """One row a trial, with its genotype (amplitudes, then offsets in turns); only where `log` asked for it."""
        return self._read("behaviours", columns)

    def lineage(self, *columns: str, condition: str | None = None, seed: int | None = None) -> pd.DataFrame:
        """One row for each behaviour that was the best of its epoch, or is an ancestor of one that was.

        Parameters
        ----------
        *columns : str
            Of ``condition``, ``seed``, ``epoch``, ``slot``, ``parent``, ``performance``, ``status``; ``best``: whether
            it was the best of its epoch; ``final``: whether it is the best of the last epoch or an ancestor of it;
            ``genotype``; ``modification``: Euclidean distance from the parent's genotype, 0 in epoch 0; ``path``: sum
            of the modifications from its ancestor in epoch 0 to it. The last three take stored behaviours. Without
            columns, all that the results have.
        condition, seed : optional
            Only these runs; files of others stay closed.

        Returns
        -------
        DataFrame
            Of runs whose `log` kept what the columns need.

        Raises
        ------
        StoreError
            If there is no such run, or no such column.
        """
        return lineage.lineage(self, columns, condition, seed)

    def ancestors(self, condition: str, seed: int, epoch: int | None = None, slot: int | None = None) -> pd.DataFrame:
        """The ancestry of a behaviour: one row for each epoch from 0 to its own, columns as of `lineage`.

        Parameters
        ----------
        condition : str
        seed : int
        epoch : int, optional
            Without it, the last.
        slot : int, optional
            Without it, that of the best of the epoch.

        Raises
        ------
        StoreError
            If there is no such run, epoch or slot, or if the run's `log` did not keep trials.
        """
        return lineage.ancestors(self, condition, seed, epoch, slot)

    def frame(self, table: pa.Table) -> pd.DataFrame:
        """Rows of a stored table as a frame, `condition` an ordered categorical."""
        frame = table.unify_dictionaries().to_pandas()
        if "condition" in frame:
            frame["condition"] = pd.Categorical(frame["condition"].astype(str), self.conditions, ordered=True)
        return frame

    def lacking(self, table: str) -> StoreError:
        """What to tell of a table that was not kept."""
        return StoreError(
            f"{self.folder} has no {table}; set `log: {table}` in the configuration and run it into another folder"
        )

    def _read(self, table: str, columns: tuple[str, ...]) -> pd.DataFrame:
        files = self.manifest.files(table)
        if not files:
            raise self.lacking(table)
        return self.frame(read_tables(self.folder, files, list(columns) or None))


def _nearest(name: str, names: Sequence[str]) -> str:
    """The name that was meant, or else all there are, as the end of a sentence."""
    if close := difflib.get_close_matches(name, names, n=1):
        return f"did you mean {close[0]}?"
    others = f" and {len(names) - MOST_NAMES:,} more" if len(names) > MOST_NAMES else ""
    return f"it has {', '.join(names[:MOST_NAMES])}{others}"


def load(folder: str | Path) -> Results:
    """Open the results in a folder.

    Raises
    ------
    StoreError
        If there is no finished run in it.
    """
    folder = Path(folder)
    if not manifests(folder):
        raise StoreError(f"{folder} holds no results; give the folder that a sweep has written")
    manifest = read_manifest(folder)
    if not manifest.runs:
        raise StoreError(f"{folder} holds no finished run yet; give the sweep command again to go on")
    return Results(folder, manifest)


@dataclass(frozen=True)
class _Remembered(Results):
    """Results whose table of runs is read once."""

    @cached_property
    def _whole(self) -> pd.DataFrame:
        return super().runs()

    def runs(self, *columns: str) -> pd.DataFrame:
        """One row a run: result and settings."""
        if set(columns) <= set(self._whole.columns):
            return self._whole[list(columns or self._whole.columns)].copy()
        return super().runs(*columns)  # which says why it has no such column


def remembered(results: Results) -> Results:
    """The same results, with the table of runs kept: for many figures, of which each asks for it.

    It may be thousands of files, and takes memory for all of its columns.
    """
    return _Remembered(results.folder, results.manifest)
