"""The tables of `wobblesim stability` in words, for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from wobblesim.numerics.stability import AUTHORS_STEP, Tables
from wobblesim.numerics.stability_box import CLASSES, shares
from wobblesim.physics.scene import Physics


@dataclass(frozen=True)
class Text:
    """A table of words; its first column is a name."""

    name: str
    title: str
    columns: list[str]
    rows: list[list[str]]


def texts(tables: Tables) -> Iterator[Text]:
    """All tables that people read; the frames hold more columns and rows."""
    yield limits(tables["limits"])
    yield chains(tables["chains"])
    yield box(tables["box"])
    yield corner(tables["corner"])
    yield safe(tables["safe"], "stable", "Safe factors, and the amplitude of a wobble around 1")
    yield safe(tables["safe"], "converged", "Factors at which the step is also accurate enough, and the amplitude")
    yield thetas(tables["thetas"])
    yield impacts(tables["impacts"])
    yield inside(tables["inside"])


def limits(found: pd.DataFrame) -> Text:
    """Limits of omega h on one spring."""
    rows = []
    for name, of in found.groupby("integrator", sort=False):
        cells = [_limit(row[kind]) for row in of.to_dict("records") for kind in ("theory", "measured")]
        rows.append([str(name), *cells])
    columns = ["integrator", "ζ 0: theory", "measured", "ζ 1: theory", "measured", "across: theory", "measured"]
    return Text("limits", "One spring: largest stable ω h", columns, rows)


def _limit(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.3f}" if math.isfinite(value) else "none"


def _shown(found: pd.DataFrame) -> pd.DataFrame:
    """Rows in the shipped precision: the default at the shipped step, the others at the author's."""
    default = Physics()
    precision = default.precision if (found["precision"] == default.precision).any() else found["precision"].iloc[0]
    step = found["integrator"].map(lambda name: default.dt if name == default.integrator else AUTHORS_STEP)
    return found[(found["precision"] == precision) & (found["dt"] == step)]


def chains(found: pd.DataFrame) -> Text:
    """Hanging chains."""
    rows = [
        [row["integrator"], f"{row['dt']:g}", f"{row['end_mass']:g}", f"{row['omega_h']:.1f}", row["status"],
         f"{row['peak']:.3f}", f"{row['exact_peak']:.3f}", f"{row['final']:.3f}", f"{row['exact_final']:.3f}",
         f"{row['path_error']:.2g}"]
        for row in _shown(found).to_dict("records")
    ]  # fmt: skip
    columns = ["integrator", "dt", "end mass", "ω h", "status", "peak", "exact", "late mean", "exact", "path error"]
    return Text("chains", "Hanging chain of 40 nodes: stretch over its static value", columns, rows)


def box(found: pd.DataFrame) -> Text:
    """Share of the box in each class."""
    rows = [
        [row["integrator"], row["precision"], f"{row['dt']:g}", *(f"{100 * row[name]:.0f} %" for name in CLASSES)]
        for row in shares(found).to_dict("records")
    ]
    return Text(
        "box", "Morphology box: share of the cells", ["integrator", "precision", "dt", *CLASSES], rows
    )  # fmt: skip


def corner(found: pd.DataFrame) -> Text:
    """The stiffest, lightest robot at smaller steps and under weaker gaits."""
    counts = ("shipped_bound", "floor", "flight")
    rows = [
        [f"{row['dt']:g}", f"{row['amplitude']:g}", f"{row['across']:.1f}", *(f"{row[name]}" for name in counts)]
        for row in found.to_dict("records")
    ]
    columns = ["dt", "gait's e", "h √(2 k e/m)", "shipped bound", "far bound", "far, free flight"]
    return Text("corner", f"Lightest and stiffest: diverged of {found['trials'].iloc[0]} trials", columns, rows)


def safe(found: pd.DataFrame, kind: str, title: str) -> Text:
    """Ranges of one kind, ``stable`` or ``converged``."""
    steps = sorted(found["dt"].unique(), reverse=True)
    rows = []
    for (integrator, dimension), of in found.groupby(["integrator", "dimension"], sort=False):
        by_step = of.set_index("dt")
        rows.append([f"{integrator}, {dimension}", *(_range(by_step.loc[dt], kind) for dt in steps)])
    return Text(kind, title, ["", *(f"dt {dt:g}" for dt in steps)], rows)


def _range(row: pd.Series, kind: str) -> str:
    low, high, amplitude = (row[f"{kind}_{name}"] for name in ("low", "high", "amplitude"))
    return "none" if math.isnan(low) else f"{low:g}–{high:g} ({amplitude:.2f})"


def thetas(found: pd.DataFrame) -> Text:
    """Diverged trials over theta."""
    values = sorted(found["theta"].unique())
    rows = []
    for (dt, mass, floor), of in found.groupby(["dt", "mass", "floor"], sort=False):
        counts = of.set_index("theta")
        rows.append([f"{floor}", f"{dt:g}", f"{mass:g}", *(_count(counts.loc[theta]) for theta in values)])
    trials = found["trials"].iloc[0]
    title = f"midpoint: diverged of {trials} trials (after repeats at half the step)"
    return Text("thetas", title, ["floor stiffness", "dt", "mass", *(f"θ {theta:g}" for theta in values)], rows)


def _count(row: pd.Series) -> str:
    return f"{row['diverged']} ({row['still_diverged']})" if row["diverged"] else "0"


def impacts(found: pd.DataFrame) -> Text:
    """Fast impacts."""
    rows = [
        [f"{row['body']}, {row['integrator']}", f"{row['speed']:g}", row["status"], f"{row['deepest']:.3g}",
         _number(row["documented"]), f"{row['through']}",
         f"{row['least_rebound']:.3f} to {row['largest_rebound']:.3f}" if row["body"] == "nodes" else "",
         _percent(row["rise"])]
        for row in _shown(found).to_dict("records")
    ]  # fmt: skip
    columns = ["body", "speed", "status", "deepest", "bound", "through", "rebound", "energy rise"]
    return Text("impacts", "Impacts (u/s, u)", columns, rows)


def inside(found: pd.DataFrame) -> Text:
    """Starts inside the floor."""
    rows = [
        [f"{row['body']}, {row['integrator']}", f"{row['depth']:g}", row["status"], f"{row['exit']:.4g}",
         _number(row["law"]), _number(row["energy_bound"]), f"{row['fall']:.3g}", f"{row['through']}",
         _percent(row["rise"])]
        for row in _shown(found).to_dict("records")
    ]  # fmt: skip
    columns = ["body", "depth", "status", "exit", "law", "most", "√(2gd)", "through", "energy rise"]
    return Text("inside", "Starts inside the floor (u, u/s)", columns, rows)


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) and value else "–"


def _percent(value: float) -> str:
    return "–" if math.isnan(value) else f"{100 * value:.1f} %" if math.isfinite(value) else "not finite"
