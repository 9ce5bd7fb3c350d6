"""The columns of the stored tables.

Every file of a table has the same columns, whatever was swept: what does not apply is null, never missing. A change
here is a change of `SCHEMA_VERSION`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa

SCHEMA_VERSION = 3

TABLES_OF_LOG = {
    "epochs": ("epochs",),
    "trials": ("epochs", "trials"),
    "behaviours": ("epochs", "trials", "behaviours"),
}
"""Tables that `log` asks for, besides `runs`."""

TEXT, REAL, WHOLE, COUNT, YES_NO = pa.string(), pa.float64(), pa.int64(), pa.int32(), pa.bool_()

# The folders `condition=<id>` say it again; pandas and pyarrow read the name of a folder as a dictionary, and refuse a
# column of the same name and another type.
NAME = pa.dictionary(pa.int32(), pa.string())

RUN = {"condition": NAME, "seed": WHOLE}

PARAMETERS = {
    "robot.kind": TEXT,
    "robot.arms": COUNT,
    "robot.sections": COUNT,
    "robot.height": REAL,
    "robot.width": REAL,
    "robot.center_side": REAL,
    "robot.groups_per_arm": COUNT,
    "robot.node_mass": REAL,
    "robot.friction": REAL,
    "robot.stiffness.diagonal": REAL,
    "robot.stiffness.side": REAL,
    "robot.stiffness.width": REAL,
    "robot.stiffness.center": REAL,
    "robot.stiffness.tip": REAL,
    "robot.damping_ratio": REAL,
    "robot.nodes": COUNT,
    "robot.springs": COUNT,
    "robot.muscles": COUNT,
    "robot.digest": TEXT,
    "scene.gravity.x": REAL,
    "scene.gravity.y": REAL,
    "scene.floor.restitution": REAL,
    "scene.floor.restitution_threshold": REAL,
    "scene.floor.stiffness": REAL,
    "physics.integrator": TEXT,
    "physics.dt": REAL,
    "physics.precision": TEXT,
    "physics.iterations": COUNT,
    "physics.theta": REAL,
    "physics.max_speed": REAL,
    "physics.max_strain": REAL,
    "physics.max_energy": REAL,
    "physics.refinements": COUNT,
    "trial.duration": REAL,
    "trial.period": REAL,
    "trial.max_amplitude": REAL,
    "learning.epochs": COUNT,
    "learning.population": COUNT,
    "learning.parents": COUNT,
    "learning.rate": REAL,
    "learning.scale": REAL,
    "learning.direction": TEXT,
    "wobble.dimension": TEXT,
    "wobble.amplitude": REAL,
    "wobble.period": REAL,
    "wobble.end": COUNT,
    "wobble.decay_start": COUNT,
    "wobble.mean": REAL,
    "wobble.upper_bound": REAL,
    "log": TEXT,
}
"""Every setting of a condition, under the name it has in YAML and in `--set`: those of `wobblesim.config.columns`."""

COLUMNS: dict[str, dict[str, pa.DataType]] = {
    "runs": {
        **RUN,
        "status": TEXT,
        "performance": REAL,
        "path_before": REAL,
        "path_after": REAL,
        "epochs": COUNT,
        "trials": WHOLE,
        "diverged": WHOLE,
        "refined": WHOLE,
        "limited": WHOLE,
        "reused": WHOLE,
        "seconds": REAL,
        **PARAMETERS,
    },
    "epochs": {
        **RUN,
        "epoch": COUNT,
        "mass": REAL,
        "stiffness": REAL,
        "size": REAL,
        "gravity": REAL,
        "best": REAL,
        "mean": REAL,
        "ok": COUNT,
        "limited": COUNT,
        "refined": COUNT,
        "diverged": COUNT,
        "reused": COUNT,
        "path": REAL,
        "step_distance": REAL,
    },
    "trials": {
        **RUN,
        "epoch": COUNT,
        "slot": COUNT,
        "parent": COUNT,
        "performance": REAL,
        "status": TEXT,
        "dt": REAL,
        "bound": TEXT,
        "limited": COUNT,
        "diverged_at": REAL,
        "reused": YES_NO,
    },
    "behaviours": {**RUN, "epoch": COUNT, "slot": COUNT},
}


WITH_GENOTYPE = ("runs", "behaviours")
"""Tables whose last column is a genotype: of each trial, or of the best behaviour of the last epoch."""


@cache
def schema(table: str, genes: int = 0) -> pa.Schema:
    """Columns of a table, in order; `genes` is the length of a genotype."""
    columns = dict(COLUMNS[table])
    if table in WITH_GENOTYPE:
        columns["genotype"] = pa.list_(pa.float64(), genes)
    return pa.schema(list(columns.items()))


@cache
def encodings(table: str) -> Mapping[str, Any]:
    """How pyarrow's writer packs the columns of a table: repeated words in a dictionary, doubles byte by byte."""
    fields = list(schema(table))
    words = [field.name for field in fields if field.type in (TEXT, NAME)]
    reals = [field.name for field in fields if field.type == REAL]
    lists = [f"{field.name}.list.element" for field in fields if pa.types.is_fixed_size_list(field.type)]
    return {"use_dictionary": words, "use_byte_stream_split": reals + lists}


def table(name: str, columns: Mapping[str, Any]) -> pa.Table:
    """Make a table of columns (n,), those missing null; `genotype` is (n, genes).

    A column that is one value instead of an array holds it in every row; if all are, there is one row.
    """
    rows = max((len(column) for column in columns.values() if isinstance(column, np.ndarray)), default=1)
    target = schema(name, columns["genotype"].shape[1] if name in WITH_GENOTYPE else 0)
    arrays = [_array(columns.get(key), rows, kind) for key, kind in zip(target.names, target.types, strict=True)]
    return pa.Table.from_arrays(arrays, schema=target)


def row(values: Mapping[str, Any]) -> dict[str, pa.Array]:
    """Settings as columns of one row, made once for all runs that share them."""
    return {name: _array(value, 1, PARAMETERS[name]) for name, value in values.items()}


def _array(column: Any, rows: int, kind: pa.DataType) -> pa.Array:
    if isinstance(column, pa.Array):
        return column
    if isinstance(column, np.ndarray) and column.ndim == 2:
        return pa.FixedSizeListArray.from_arrays(pa.array(column.ravel()), kind.list_size)
    if isinstance(column, np.ndarray):
        return pa.array(column, kind)
    if kind == NAME:
        return pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), pa.array([column], TEXT))
    return pa.repeat(pa.scalar(column, kind), rows)


def flat(parameters: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings by dotted key: ``{"wobble": {"period": 25}}`` gives ``{"wobble.period": 25}``."""
    leaves: dict[str, Any] = {}
    for key, value in parameters.items():
        if isinstance(value, Mapping):
            leaves |= flat(value, f"{prefix}{key}.")
        else:
            leaves[f"{prefix}{key}"] = value
    return leaves
