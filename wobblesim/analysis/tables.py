"""The stored tables as pandas frames, only the columns asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from wobblesim.study.errors import StoreError
from wobblesim.study.files import read_tables
from wobblesim.study.manifest import Manifest, manifests, read_manifest


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

    def _read(self, table: str, columns: tuple[str, ...]) -> pd.DataFrame:
        files = self.manifest.files(table)
        if not files:
            raise StoreError(
                f"{self.folder} has no {table}; set `log: {table}` in the configuration and run it into another folder"
            )
        frame = read_tables(self.folder, files, list(columns) or None).unify_dictionaries().to_pandas()
        if "condition" in frame:
            frame["condition"] = pd.Categorical(frame["condition"].astype(str), self.conditions, ordered=True)
        return frame


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
