"""A stored run, repeated from what its own file says of it, and compared with its rows bit for bit."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import ValidationError

from wobblesim.config import Parameters, columns
from wobblesim.config.errors import dotted, one_line, problems
from wobblesim.learning.run import Epoch, Learner, Setup
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.study.errors import StoreError, first_line
from wobblesim.study.files import damage, read_about
from wobblesim.study.group import Group, written_seeds
from wobblesim.study.manifest import OF_DATASET, UNREADABLE, manifests, read_manifest
from wobblesim.study.plan import lane_steps, setup
from wobblesim.study.progress import Meter, Progress
from wobblesim.study.provenance import provenance
from wobblesim.study.rows import Log, run_tables
from wobblesim.study.schema import SCHEMA_VERSION, TABLES_OF_LOG
from wobblesim.study.work import Beat

LOG_OF_TABLE = {"runs": "epochs", "epochs": "epochs", "trials": "trials", "behaviours": "behaviours"}
"""The least that must be logged for a table."""

UNCOMPARED = ("seconds",)
"""Columns that differ from time to time."""


@dataclass(frozen=True, eq=False)
class StoredRun:
    """One run of a Parquet file, as the file itself tells it; made by `read_run`.

    Attributes
    ----------
    path : Path
    table : str
        "runs", "epochs", "trials" or "behaviours".
    condition : str
    seed : int
    parameters : Parameters
        The settings of the run.
    provenance : dict of str to str
        What computed it, see `provenance`.
    rows : pa.Table
    """

    path: Path
    table: str
    condition: str
    seed: int
    parameters: Parameters
    provenance: dict[str, str]
    rows: pa.Table

    @cached_property
    def setup(self) -> Setup:
        """What the run simulates."""
        return setup(self.parameters)

    @property
    def rows_an_epoch(self) -> int:
        """Rows of the table for each epoch; 0 if one row is of all."""
        return _rows_an_epoch(self.table, self.parameters)


@dataclass(frozen=True)
class Difference:
    """A column that came out otherwise.

    Attributes
    ----------
    column : str
    rows : int
        How many differ.
    first : int
        The first of them.
    stored, here : object
        The values of that row: in the file, and as computed now.
    largest : float or None
        Largest difference of two numbers; None if there are none to subtract.
    """

    column: str
    rows: int
    first: int
    stored: Any
    here: Any
    largest: float | None


@dataclass(frozen=True, eq=False)
class Verdict:
    """What came of repeating a run.

    Attributes
    ----------
    run : StoredRun
    epochs, rows, columns : int
        How many were compared.
    differences : tuple of Difference
        The columns whose bits do not agree.
    provenance : dict of str to (str, str)
        What the run was computed with, stored and here.
    """

    run: StoredRun
    epochs: int
    rows: int
    columns: int
    differences: tuple[Difference, ...]
    provenance: dict[str, tuple[str, str]]

    @property
    def agree(self) -> bool:
        """Whether every bit is the same."""
        return not self.differences

    @property
    def changed(self) -> dict[str, tuple[str, str]]:
        """What differs in the provenance."""
        return {name: pair for name, pair in self.provenance.items() if pair[0] != pair[1]}

    def place(self, row: int) -> dict[str, int]:
        """Epoch, and slot if rows have one, of a row; nothing for the row of a run."""
        if not self.run.rows_an_epoch:
            return {}
        epoch, slot = divmod(row, self.run.rows_an_epoch)
        return {"epoch": epoch} if self.run.table == "epochs" else {"epoch": epoch, "slot": slot}


# --- the file ------------------------------------------------------------------------------------------------------


def read_run(path: Path, seed: int | None = None) -> StoredRun:
    """Read a run from any Parquet file of a results folder, wherever the file is now.

    Parameters
    ----------
    path : Path
        If it lies in its results folder, it is first compared with what the manifest says of it.
    seed : int, optional
        Which run, in a file of several.

    Raises
    ------
    StoreError
        If the file is cut, altered, or not one of ours, or if it does not hold that run.
    """
    _check_against_manifest(path)
    with _refusing(path):
        about = read_about(path)
        table, condition, parameters, seeds = about["table"], about["condition"], _parameters(about), _seeds(about)
        mine = _choose(path, seeds, seed)
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            _check_rows(file.metadata.num_rows, table, parameters, len(seeds))
            rows = _rows_of(file, mine)
        _check_rows(len(rows), table, parameters, 1)
        told = {name: one_line(value) for name, value in (about | _source(about, mine)).items()}
    return StoredRun(path, table, one_line(condition), mine, parameters, told, rows)


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Say in one sentence what is wrong with a file."""
    try:
        yield
    except KeyError as error:
        raise _unusable(path, f"its metadata lack {error}") from error
    except (*UNREADABLE, OSError, pa.ArrowException) as error:
        raise _unusable(path, first_line(error)) from error


def _unusable(path: Path, why: str) -> StoreError:
    return StoreError(f"{path} cannot be repeated: {one_line(why)}; give a whole, unaltered file of a results folder")


def _check_against_manifest(path: Path) -> None:
    """Refuse a file in a results folder that is not what was written there; elsewhere nobody knows what it should be.

    Raises
    ------
    StoreError
        If it is missing, cut, altered or foreign.
    """
    place = path.resolve()
    folder = place.parents[min(2, len(place.parents) - 1)]
    relative = place.relative_to(folder).as_posix()
    if not OF_DATASET.fullmatch(relative) or not manifests(folder):
        return
    file = read_manifest(folder).every_file().get(relative)
    fault = "is of no run: no line of the manifest names it" if file is None else damage(folder, file)
    if fault:
        raise StoreError(f"{path} {fault}; `wobblesim verify {folder}` finds all such files")


def _parameters(about: Mapping[str, str]) -> Parameters:
    """The settings of the run; ValueError if they describe none."""
    stored = json.loads(about["config"])
    try:
        parameters = Parameters.model_validate(stored)
    except ValidationError as error:
        fault = problems(error, stored, Parameters)[0]
        raise ValueError(f"its settings are not sound: {dotted(fault.paths[0])}: {fault.message}") from error
    if about["table"] not in ("runs", *TABLES_OF_LOG[parameters.log]):
        raise ValueError(f"a run with the log {parameters.log} has no table {about['table']}")
    return parameters


def _seeds(about: Mapping[str, str]) -> list[int]:
    """The seeds of a file: one, or those of a compacted condition."""
    return [int(seed) for seed in json.loads(about["seeds"])] if "seeds" in about else [int(about["seed"])]


def _source(about: Mapping[str, str], seed: int) -> dict[str, str]:
    """What computed a run of a compacted file, whose runs may be of several origins."""
    for source in json.loads(about.get("sources", "[]")):
        if seed in source["seeds"]:
            return {name: str(value) for name, value in source.items() if name != "seeds"}
    return {}


def _choose(path: Path, seeds: list[int], seed: int | None) -> int:
    if seed is None and len(seeds) == 1:
        return seeds[0]
    if seed in seeds:
        return seed
    wrong = "choose one with --seed" if seed is None else f"there is no seed {seed} in it"
    raise StoreError(f"{path} holds {written_seeds(seeds)}; {wrong}")


def _rows_an_epoch(table: str, parameters: Parameters) -> int:
    return {"runs": 0, "epochs": 1}.get(table, parameters.learning.population)


def _check_rows(found: int, table: str, parameters: Parameters, runs: int) -> None:
    """Refuse a file with other rows than its settings make, before they are read: there may be very many."""
    each = _rows_an_epoch(table, parameters) * parameters.learning.epochs or 1
    if found != runs * each:
        raise ValueError(f"it has {found:,} rows of {table}, where its settings make {runs * each:,}")


def _rows_of(file: pq.ParquetFile, seed: int) -> pa.Table:
    """The rows of a run, the file read a row group at a time.

    Not by `pq.read_table` with a filter, which waits for ever on some damaged files, nor with the statistics of the
    columns, which end the process on the same ones.
    """
    is_mine = pc.field("seed") == seed
    groups = range(file.num_row_groups)
    mine = [group for group in groups if len(file.read_row_group(group, columns=["seed"]).filter(is_mine))]
    if not mine:
        raise ValueError(f"it has no rows of seed {seed}")
    return pa.concat_tables(file.read_row_group(group).filter(is_mine) for group in mine)


# --- the repetition ------------------------------------------------------------------------------------------------


def rerun(
    run: StoredRun,
    epochs: int | None = None,
    *,
    threads: int | None = None,
    progress: Callable[[Progress], None] | None = None,
    simulate: Callable[..., Trials] = simulate,
) -> Verdict:
    """Compute a stored run again, and compare.

    Parameters
    ----------
    run : StoredRun
    epochs : int, optional
        Only so many, from the first.
    threads : int, optional
        As for `simulate`; the bits do not depend on it.
    progress : callable, optional
        Called with a `Progress` at the begin, after every epoch and at the end.
    simulate : callable
        Called as `wobblesim.simulate` is.

    Raises
    ------
    StoreError
        If the run cannot be simulated, or if only the whole of it could be compared.
    """
    whole = run.parameters.learning.epochs
    wanted = min(epochs or whole, whole)
    if wanted < whole and not run.rows_an_epoch:
        raise StoreError(
            f"{run.path} sums up all {whole:,} epochs; give the run's file in epochs/ to repeat some of them"
        )
    try:
        here = _repeated(run, wanted, threads, progress or (lambda _: None), simulate)
    except ValueError as error:
        raise _unusable(run.path, str(error)) from error
    stored = run.rows.slice(0, len(here))
    names = [name for name in dict.fromkeys((*stored.column_names, *here.column_names)) if name not in UNCOMPARED]
    found = (_difference(name, stored, here) for name in names)
    sources = provenance() | {"schema_version": str(SCHEMA_VERSION)}
    compared = {name: (run.provenance.get(name, ""), value) for name, value in sources.items()}
    return Verdict(run, wanted, len(here), len(names), tuple(filter(None, found)), compared)


def _repeated(
    run: StoredRun,
    epochs: int,
    threads: int | None,
    tell: Callable[[Progress], None],
    simulate: Callable[..., Trials],
) -> pa.Table:
    """The rows of the first epochs, computed now."""
    log, group = Log((run.seed,), LOG_OF_TABLE[run.table]), Group(run.condition, (run.seed,))
    learner = Learner(run.setup, group.seeds, threads, simulate=simulate)
    work = lane_steps(run.setup) - lane_steps(run.setup, epochs)
    meter = Meter(tell, wanted=1, present=0, failed=0, work=work)
    meter.tell("begin")
    while learner.epoch < epochs:
        epoch = learner.advance()
        log.add(epoch)
        meter.hear(_beat(group, run.setup, epoch, epochs))
    meter.done = 1
    meter.tell("end")
    tables = run_tables(log.columns(), 0, run.seed, run.condition, columns(run.parameters), 0.0)
    return tables[run.table]


def _beat(group: Group, made: Setup, epoch: Epoch, epochs: int) -> Beat:
    work = lane_steps(made, epoch.epoch) - lane_steps(made, epoch.epoch + 1)
    diverged, refined = (int((epoch.status == status).sum()) for status in ("diverged", "refined"))
    return Beat(group, epoch.epoch + 1, epochs, work=work, diverged=diverged, refined=refined)


# --- the comparison ------------------------------------------------------------------------------------------------


def _difference(name: str, stored: pa.Table, here: pa.Table) -> Difference | None:
    """How a column of two tables of the same length differs; None if every bit is the same."""
    if name not in stored.column_names or name not in here.column_names:
        told = [
            str(table.schema.field(name).type) if name in table.column_names else "absent" for table in (stored, here)
        ]
        return Difference(name, len(here), 0, *told, largest=None)
    there, now = (_plain(table[name]) for table in (stored, here))
    if there.type != now.type:
        return Difference(name, len(here), 0, str(there.type), str(now.type), largest=None)
    parts = list(zip(_parts(there), _parts(now), strict=True))
    differs = np.array([_differs(a, b) for a, b in parts])
    if not differs.any():
        return None
    row = int(differs.any(axis=0).argmax())
    a, b = parts[int(differs[:, row].argmax())]
    gaps = (_largest(*pair, rows) for pair, rows in zip(parts, differs, strict=True))
    largest = max((gap for gap in gaps if gap is not None), default=None)
    return Difference(name, int(differs.any(axis=0).sum()), row, a[row].as_py(), b[row].as_py(), largest)


def _plain(column: pa.ChunkedArray) -> pa.ChunkedArray:
    return column.cast(pa.string()) if pa.types.is_dictionary(column.type) else column


def _parts(column: pa.ChunkedArray) -> list[pa.ChunkedArray]:
    """A column of lists as one column for each place in the list."""
    if pa.types.is_fixed_size_list(column.type):
        return [pc.list_element(column, place) for place in range(column.type.list_size)]
    return [column]


def _differs(a: pa.ChunkedArray, b: pa.ChunkedArray) -> np.ndarray:
    """Rows in which two columns of one type are not the same bits, or not both null."""
    missing = [column.is_null().to_numpy() for column in (a, b)]
    return (missing[0] != missing[1]) | (_bits(a) != _bits(b))


def _bits(column: pa.ChunkedArray) -> np.ndarray:
    """Values that are equal if their bits are, also those of NaN and of -0; nulls are any one value."""
    is_text = pa.types.is_string(column.type)
    values = column.fill_null(pa.scalar("" if is_text else 0).cast(column.type)).to_numpy()
    return values.view(f"u{values.itemsize}") if pa.types.is_floating(column.type) else values


def _largest(a: pa.ChunkedArray, b: pa.ChunkedArray, rows: np.ndarray) -> float | None:
    """The largest difference of two numbers in some rows; None if there are none to subtract."""
    if not (pa.types.is_floating(a.type) or pa.types.is_integer(a.type)):
        return None
    there, here = (column.cast(pa.float64()).to_numpy()[rows] for column in (a, b))
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        gaps = np.abs(there - here)
    gaps = gaps[~np.isnan(gaps)]
    return float(gaps.max()) if len(gaps) else None
