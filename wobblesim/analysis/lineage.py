"""Who descends from whom: the best behaviours of a run, their ancestors, and the way that the search has gone.

A run is a forest: each behaviour of an epoch is, or was made from, one of the epoch before, its parent. The functions
on arrays take S runs of E epochs and P slots at once and loop over epochs only. `lineage` and `ancestors` read what
they need of the stored tables; `Results` has them as methods.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from wobblesim.study.errors import StoreError
from wobblesim.study.files import FileRecord, read_tables

if TYPE_CHECKING:
    from wobblesim.analysis.tables import Results

STORED = ("condition", "seed", "epoch", "slot", "parent", "performance", "status")
OF_TRIALS = (*STORED, "best", "final")
OF_BEHAVIOURS = ("genotype", "modification", "path")
"""Columns of a lineage that take stored behaviours."""

FOR_SHAPE = ("seed", "slot", "parent", "performance")
"""Columns of the table of trials that every lineage is worked out from."""


# --- on arrays -----------------------------------------------------------------------------------------------------


def best_slots(performance: NDArray[np.float64]) -> NDArray[np.intp]:
    """Slot of the best of `performance` (..., P), as the search ranks: NaN last, ties by slot."""
    return np.where(np.isnan(performance), -np.inf, performance).argmax(axis=-1)


def ancestry(parent: NDArray[np.integer], slot: NDArray[np.integer]) -> NDArray[np.intp]:
    """Slots (S, E) of the ancestors, epoch by epoch, of the behaviours in `slot` (S,) of the last epoch.

    Parameters
    ----------
    parent : (S, E, P)
        Slot of the epoch before; that of epoch 0 is not looked at.
    slot : (S,)
    """
    runs, epochs, _ = parent.shape
    slots = np.empty((runs, epochs), dtype=np.intp)
    slots[:, -1] = slot
    for epoch in range(epochs - 1, 0, -1):
        slots[:, epoch - 1] = parent[np.arange(runs), epoch, slots[:, epoch]]
    return slots


def with_ancestors(parent: NDArray[np.integer], slots: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Mask (S, E, P) of the behaviours in `slots` (S, E), one an epoch, and of all their ancestors.

    Parameters
    ----------
    parent : (S, E, P)
    slots : (S, E)
    """
    mask = marked(slots, parent.shape[2])
    for epoch in range(parent.shape[1] - 1, 0, -1):
        run, slot = np.nonzero(mask[:, epoch])
        mask[run, epoch - 1, parent[run, epoch, slot]] = True
    return mask


def marked(slots: NDArray[np.integer], population: int) -> NDArray[np.bool_]:
    """Mask (..., P) of the behaviours in `slots` (...)."""
    return slots[..., None] == np.arange(population)


def modifications(
    parent: NDArray[np.integer], mask: NDArray[np.bool_], genotypes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Euclidean distance of each behaviour of a mask from its parent; 0 in epoch 0.

    Parameters
    ----------
    parent, mask : (S, E, P)
        The parents of what the mask holds are in the mask.
    genotypes : (N, 2G)
        Of the behaviours of the mask, in its order: amplitudes, then offsets as the numbers they are, not modulo 1.

    Returns
    -------
    array (N,)
        The same bits as the learner's.
    """
    place = np.full(mask.shape, -1, dtype=np.intp)
    place[mask] = np.arange(len(genotypes))
    run, epoch, slot = np.nonzero(mask)
    born = np.flatnonzero(epoch > 0)
    run, epoch, slot = run[born], epoch[born], slot[born]
    origin = place[run, epoch - 1, parent[run, epoch, slot]]
    distances = np.zeros(len(genotypes))
    for part in np.array_split(np.arange(len(born)), 1 + len(born) // BLOCK):
        step = genotypes[born[part]] - genotypes[origin[part]]
        distances[born[part]] = np.sqrt(np.square(step).sum(axis=-1))
    return distances


BLOCK = 100_000
"""Genotypes that are copied at once: all of a study would not fit into the memory twice."""


def paths(
    parent: NDArray[np.integer], mask: NDArray[np.bool_], modification: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Search distance (N,) of each behaviour of a mask: sum of the modifications (N,) along its ancestry."""
    runs, epochs, _ = mask.shape
    length = np.zeros(mask.shape)
    length[mask] = modification
    for epoch in range(1, epochs):
        # In the order of the learner, whose sum begins with the oldest: other orders have other bits.
        length[:, epoch] = length[np.arange(runs)[:, None], epoch - 1, parent[:, epoch]] + length[:, epoch]
    return length[mask]


# --- on stored tables ----------------------------------------------------------------------------------------------


def lineage(results: Results, columns: Sequence[str], condition: str | None, seed: int | None) -> pd.DataFrame:
    """As `Results.lineage`."""
    _check_names(results, columns)
    results.require(condition, seed)
    columns = columns or _kept(results, condition, seed)
    frames = [
        trials.frame(with_ancestors(trials.parent, trials.best), columns)
        for trials in _each_condition(results, columns, condition, seed)
    ]
    if not frames:
        raise results.lacking(_tables(columns)[-1])
    return pd.concat(frames, ignore_index=True)


def ancestors(results: Results, condition: str, seed: int, epoch: int | None, slot: int | None) -> pd.DataFrame:
    """As `Results.ancestors`."""
    results.require(condition, seed)
    columns = _kept(results, condition, seed)
    trials = next(_each_condition(results, columns, condition, seed), None)
    if trials is None:
        raise results.lacking("trials")
    epoch = trials.last if epoch is None else epoch
    _check_place(f"{condition} with seed {seed}", "epoch", epoch, trials.last)
    slot = int(trials.best[0, epoch]) if slot is None else slot
    _check_place(f"{condition} with seed {seed}", "slot", slot, trials.parent.shape[2] - 1)
    mask = np.zeros(trials.parent.shape, dtype=bool)
    mask[:, : epoch + 1] = marked(ancestry(trials.parent[:, : epoch + 1], np.array([slot])), trials.parent.shape[2])
    return trials.frame(mask, columns)


def _check_names(results: Results, columns: Sequence[str]) -> None:
    known = (*OF_TRIALS, *OF_BEHAVIOURS)
    for name in columns:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1) or [", ".join(known)]
            raise StoreError(f"a lineage of {results.folder} has no column {name!r}; nearest: {close[0]}")


def _check_place(run: str, what: str, number: int, last: int) -> None:
    if not 0 <= number <= last:
        raise StoreError(f"the run of {run} has no {what} {number}; give one of 0 to {last}")


def _tables(columns: Collection[str]) -> tuple[str, ...]:
    """Tables that columns are made from."""
    return ("trials", "behaviours") if set(columns) & set(OF_BEHAVIOURS) else ("trials",)


def _kept(results: Results, condition: str | None, seed: int | None) -> tuple[str, ...]:
    """All columns that every run with trials has, of those asked for."""
    kept = [
        run.files.keys()
        for (name, number), run in results.manifest.runs.items()
        if condition in (None, name) and seed in (None, number) and "trials" in run.files
    ]
    whole = kept and all("behaviours" in tables for tables in kept)
    return (*OF_TRIALS, *OF_BEHAVIOURS) if whole else OF_TRIALS


def _each_condition(
    results: Results, columns: Collection[str], condition: str | None, seed: int | None
) -> Iterator[_Trials]:
    """The trials of each condition, of runs that have the tables which the columns need."""
    tables = _tables(columns)
    for name in results.conditions if condition is None else [condition]:
        seeds = [
            number
            for number in (results.seeds(name) if seed is None else [seed])
            if (run := results.manifest.runs.get((name, number))) and all(table in run.files for table in tables)
        ]
        if seeds:
            yield _trials(results, name, seeds, columns)


@dataclass(frozen=True)
class _Trials:
    """Trials of runs of one condition, and what of them a lineage is worked out from.

    Attributes
    ----------
    results : Results
    condition : str
    seeds : list of int
        Of the S runs, in order.
    table : pa.Table
        S * E * P rows.
    parent : (S, E, P)
    best : (S, E)
        Slots.
    """

    results: Results
    condition: str
    seeds: list[int]
    table: pa.Table
    parent: NDArray[np.int32]
    best: NDArray[np.intp]

    @property
    def last(self) -> int:
        """The last epoch."""
        return self.parent.shape[1] - 1

    def frame(self, mask: NDArray[np.bool_], columns: Collection[str]) -> pd.DataFrame:
        """The behaviours of a mask (S, E, P), which holds their parents."""
        rows = self.table.select([name for name in self.table.column_names if name in columns])
        frame = self.results.frame(rows.take(np.flatnonzero(mask)))
        population = mask.shape[2]
        frame["best"] = marked(self.best, population)[mask]
        frame["final"] = marked(ancestry(self.parent, self.best[:, -1]), population)[mask]
        if "behaviours" in _tables(columns):
            genotypes = self._genotypes(mask)
            frame["genotype"] = pd.Series(list(genotypes), dtype=object)
            frame["modification"] = modifications(self.parent, mask, genotypes)
            frame["path"] = paths(self.parent, mask, frame["modification"].to_numpy())
        return frame[list(columns)]

    def _genotypes(self, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Genotypes (N, 2G) of a mask; one file is in the memory at a time."""
        size = mask[0].size
        mine = dict(zip(self.seeds, mask.reshape(len(mask), size), strict=True))
        found = {}
        for file in _files(self.results, "behaviours", self.condition, self.seeds):
            table = read_tables(self.results.folder, [file], ["seed", "genotype"])
            for start in range(0, table.num_rows, size):
                seed = table["seed"][start].as_py()
                if seed in mine:
                    found[seed] = _as_matrix(table["genotype"].slice(start, size).filter(pa.array(mine[seed])))
        return np.concatenate([found[seed] for seed in self.seeds])


def _trials(results: Results, condition: str, seeds: list[int], columns: Collection[str]) -> _Trials:
    stored = [name for name in STORED if name in columns or name in FOR_SHAPE]
    table = read_tables(results.folder, _files(results, "trials", condition, seeds), stored)
    if len(table) and len(pc.unique(table["seed"])) > len(seeds):
        table = table.filter(pc.is_in(table["seed"], pa.array(seeds)))
    population = 1 + pc.max(table["slot"]).as_py()
    shape = (len(seeds), -1, population)
    parent = table["parent"].to_numpy().reshape(shape)
    best = best_slots(table["performance"].to_numpy().reshape(shape))
    return _Trials(results, condition, seeds, table, parent, best)


def _files(results: Results, table: str, condition: str, seeds: Sequence[int]) -> list[FileRecord]:
    """Files of runs, each once: after `wobblesim compact` one holds many."""
    return list(dict.fromkeys(results.manifest.runs[condition, seed].files[table] for seed in seeds))


def _as_matrix(column: pa.ChunkedArray) -> NDArray[np.float64]:
    return column.combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(len(column), -1)
