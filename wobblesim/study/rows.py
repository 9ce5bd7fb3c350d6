"""From epochs to rows: what a group of runs has done, collected as columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from wobblesim.learning.run import Epoch
from wobblesim.learning.wobble import DIMENSIONS
from wobblesim.study.schema import TABLES_OF_LOG, table

Columns = dict[str, np.ndarray]

FINAL = "runs.genotype"
"""The best behaviour of the last epoch, which a part of a log ends with: (1, S, 2G)."""

OF_TRIALS = ("parent", "performance", "status", "dt", "bound", "limited", "diverged_at", "reused")

STATUSES = ("ok", "limited", "refined", "diverged")


class Log:
    """The epochs of a group of runs, S seeds in lockstep, P slots each.

    Columns are kept as arrays (epochs, S, ...) under the name ``table.column``, so that they can go to a checkpoint
    and come back as they are; of `FINAL` there is one row a part.

    Parameters
    ----------
    seeds : sequence of int
    log : {"epochs", "trials", "behaviours"}
        What is kept.
    """

    def __init__(self, seeds: Sequence[int], log: str) -> None:
        self.seeds = tuple(seeds)
        self.tables = TABLES_OF_LOG[log]
        self._parts: list[Columns] = []
        self._fresh: list[Columns] = []

    def add(self, epoch: Epoch) -> None:
        """Take in the next epoch."""
        self._fresh.append(self._columns(epoch))

    def _columns(self, epoch: Epoch) -> Columns:
        columns = {f"epochs.{name}": value for name, value in _epoch_columns(epoch).items()}
        columns[FINAL] = epoch.behaviours[np.arange(len(epoch.best)), epoch.best]
        if "trials" in self.tables:
            columns |= {f"trials.{name}": getattr(epoch, name) for name in OF_TRIALS}
        if "behaviours" in self.tables:
            columns["behaviours.genotype"] = epoch.behaviours
        return columns

    @property
    def parts(self) -> int:
        """How many times the log was cut."""
        return len(self._parts)

    def cut(self) -> Columns:
        """Columns of the epochs added since the last cut, a part of a checkpoint; empty if there are none."""
        if not self._fresh:
            return {}
        part = {name: np.stack([columns[name] for columns in self._fresh]) for name in self._fresh[0]}
        part[FINAL] = part[FINAL][-1:]
        self._parts.append(part)
        self._fresh = []
        return part

    def restore(self, parts: Sequence[Columns]) -> None:
        """Start from the parts of a checkpoint."""
        self._parts = list(parts)

    def columns(self) -> Columns:
        """All epochs so far, (epochs, S, ...) each, and of `FINAL` one row a part."""
        self.cut()
        return {name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]}


def _epoch_columns(epoch: Epoch) -> Columns:
    """What the table of epochs and the summary of the run hold of one epoch, (S,) each."""
    seeds = len(epoch.best)
    performance = epoch.performance
    known = np.isfinite(performance)
    counts = {status: (epoch.status == status).sum(axis=1) for status in STATUSES}
    factors = {name: np.full(seeds, getattr(epoch.morphology, name)) for name in DIMENSIONS}
    total = np.where(known, performance, 0.0).sum(axis=1)
    return {
        "epoch": np.full(seeds, epoch.epoch),
        **factors,
        "best": performance[np.arange(seeds), epoch.best],
        "mean": np.divide(total, known.sum(axis=1), out=np.full(seeds, np.nan), where=known.any(axis=1)),
        **counts,
        "reused": epoch.reused.sum(axis=1),
        "path": epoch.path,
        "path_before": epoch.path_before,
        "step_distance": epoch.step_distance,
    }


def run_tables(
    columns: Columns, index: int, seed: int, condition: str, parameters: Mapping[str, Any], seconds: float
) -> dict[str, pa.Table]:
    """The tables of one run.

    Parameters
    ----------
    columns : dict
        Of `Log.columns`.
    index : int
        Place of the run in its group.
    seed : int
    condition : str
        Its id.
    parameters : mapping
        The settings of the condition as the columns `PARAMETERS`.
    seconds : float
        Wall time of the run: its share of the group's.
    """
    run = {"condition": condition, "seed": seed}
    mine = {name: column[:, index] for name, column in columns.items()}
    tables = {"runs": table("runs", {**run, **_summary(mine, seconds), **parameters})}
    tables["epochs"] = table("epochs", run | _of(mine, "epochs"))
    for name in ("trials", "behaviours"):
        if own := _of(mine, name):
            tables[name] = table(name, run | _by_slot(own, mine["epochs.epoch"]))
    return tables


def _of(columns: Columns, name: str) -> Columns:
    return {key.removeprefix(f"{name}."): value for key, value in columns.items() if key.startswith(f"{name}.")}


def _by_slot(columns: Columns, epoch: np.ndarray) -> Columns:
    """Rows (epochs * P) of columns (epochs, P, ...), with the epoch and slot of each."""
    epochs, slots = next(iter(columns.values())).shape[:2]
    rows = {name: column.reshape(epochs * slots, *column.shape[2:]) for name, column in columns.items()}
    return rows | {"epoch": np.repeat(epoch, slots), "slot": np.tile(np.arange(slots), epochs)}


def _summary(mine: Columns, seconds: float) -> dict[str, Any]:
    """The row of a run in the table of runs."""
    epochs = _of(mine, "epochs")
    counts = {name: int(epochs[name].sum()) for name in (*STATUSES, "reused")}
    performance = float(epochs["best"][-1])
    return {
        "status": "failed" if np.isnan(performance) else "ok",
        "performance": performance,
        "path_before": float(epochs["path_before"][-1]),
        "path_after": float(epochs["path"][-1] - epochs["path_before"][-1]),
        "epochs": len(epochs["epoch"]),
        "trials": sum(counts[status] for status in STATUSES),
        **{name: counts[name] for name in ("diverged", "refined", "limited", "reused")},
        "seconds": seconds,
        "genotype": mine[FINAL][-1:],
    }
