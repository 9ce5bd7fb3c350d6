"""All trials of a run, with the wobble beneath (the paper's figure 2 A)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pyarrow.compute as pc
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import (
    FAINT,
    MOST_COLUMNS,
    OKABE_ITO,
    Drawing,
    dress,
    looks,
    mark_epoch,
    new_figure,
    over_epochs,
    performance_label,
)
from wobblesim.analysis.tables import Results
from wobblesim.learning.wobble import DIMENSIONS
from wobblesim.study.files import read_tables

MOST_PANELS = 12
"""Conditions of a figure with a panel for each; more would be too small to read."""

LOST = OKABE_ITO[4]
"""Colour of trials that diverged."""


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw a panel a condition: every trial of one run as a dot, and beneath it the factor on the adult's morphology.

    The run is that of `Choice.typical_seed`. A trial that diverged has no performance: it is a tick at the lower edge,
    and counted in the title. The table has a row for each trial: ``condition``, ``seed``, ``epoch``, ``slot``,
    ``performance`` in body lengths (NaN if it diverged), ``status``, and the factors that wobble.
    """
    check(results, choice)
    conditions = choice.shown(results)
    seed = choice.typical_seed(results, conditions)
    runs = {name: _run(results, name, seed) for name in conditions}
    table = pd.concat(runs.values(), ignore_index=True)
    dimensions = _wobbling(table)
    figure = new_figure(*_size(len(conditions)))
    clouds, wobbles = _panels(figure, len(conditions))
    ends = results.runs("condition", "wobble.end").groupby("condition", observed=True)["wobble.end"].first()
    seen = looks(conditions, choice.reference(results))
    for place, (name, run) in enumerate(runs.items()):
        _cloud(clouds[place], name, run, seen[place][0])
        _wobble(wobbles[place], run, named=len(dimensions) > 1)
        if ends[name] < run["epoch"].max():
            for axes in (clouds[place], wobbles[place]):
                mark_epoch(axes, float(ends[name]))
    _dress(clouds, wobbles, f"performance\n({performance_label(results)})", dimensions)
    figure.suptitle(_says(seed, ends[conditions], table["performance"]), x=0.01, ha="left", fontsize=9, color="0.3")
    return Drawing(figure, table.drop(columns=[name for name in DIMENSIONS if name not in dimensions]))


def check(results: Results, choice: Choice) -> None:
    """Refuse what lacks trials, or has too many conditions.

    Raises
    ------
    FigureError
    """
    require_kept(results, choice, "trials", "every trial is a dot")


def require_kept(results: Results, choice: Choice, table: str, why: str) -> None:
    """Refuse a figure with a panel a condition if one lacks a table, or if there are too many.

    Parameters
    ----------
    results : Results
    choice : Choice
    table : str
        That the figure is made of.
    why : str
        What it is for, the beginning of a sentence.

    Raises
    ------
    FigureError
    """
    conditions = choice.shown(results)
    kept = {name for (name, _), run in results.manifest.runs.items() if table in run.files}
    if lacking := [name for name in conditions if name not in kept]:
        raise FigureError(
            f"{why}, and {_some(lacking)} kept none; set `log: {table}` in the configuration and run it into another "
            "folder"
        )
    if len(conditions) > MOST_PANELS:
        raise FigureError(
            f"each condition is a panel, and {len(conditions):,} are more than the {MOST_PANELS} that fit; choose some "
            "with --condition"
        )


def _some(names: Sequence[str]) -> str:
    """Names in words: all of a few, else the first and how many others."""
    return " and ".join(names) if len(names) < 3 else f"{names[0]} and {len(names) - 1:,} other conditions"


def _run(results: Results, condition: str, seed: int) -> pd.DataFrame:
    """The trials of a run and the factors of their epochs."""
    trials = _rows(results, "trials", condition, seed, ("epoch", "slot", "performance", "status"))
    factors = _rows(results, "epochs", condition, seed, ("epoch", *DIMENSIONS))
    return trials.merge(factors.drop(columns=["condition", "seed"]), on="epoch", how="left")


def _rows(results: Results, table: str, condition: str, seed: int, columns: Sequence[str]) -> pd.DataFrame:
    """Rows of one run; files of others stay closed."""
    files = results.manifest.runs[condition, seed].files
    if table not in files:
        raise FigureError(f"the run of {condition} with seed {seed} kept no {table}; choose another with --seed")
    rows = read_tables(results.folder, [files[table]], ["condition", "seed", *columns])
    return results.frame(rows.filter(pc.equal(rows["seed"], seed)))


# --- panels --------------------------------------------------------------------------------------------------------


def _size(count: int) -> tuple[float, float]:
    rows, columns = -(-count // MOST_COLUMNS), min(count, MOST_COLUMNS)
    return {1: 5.5, 2: 8.0, 3: 10.0}.get(columns, 12.0), 0.4 + 4.0 * rows


def _panels(figure: Figure, count: int) -> tuple[list[Axes], list[Axes]]:
    """A tall panel and a flat one beneath it for each condition; all share epochs, and each kind its height."""
    rows, columns = -(-count // MOST_COLUMNS), min(count, MOST_COLUMNS)
    grid = figure.subplots(
        2 * rows, columns, squeeze=False, sharex=True, sharey="none", gridspec_kw={"height_ratios": [4, 1] * rows}
    )
    clouds, wobbles = list(grid[0::2].flat), list(grid[1::2].flat)
    for unused in (*clouds[count:], *wobbles[count:]):
        unused.remove()
    for kind in (clouds[:count], wobbles[:count]):
        for axes in kind[1:]:
            axes.sharey(kind[0])
    return clouds[:count], wobbles[:count]


def _cloud(axes: Axes, condition: str, run: pd.DataFrame, color: str) -> None:
    known = run["performance"].notna()
    axes.plot(
        run.loc[known, "epoch"], run.loc[known, "performance"], linestyle="none", marker="o", color=color,
        markersize=_size_of(len(run)), alpha=_alpha_of(len(run)), markeredgewidth=0, rasterized=True, label="trials",
    )  # fmt: skip
    lost = run.loc[~known, "epoch"]
    if len(lost):
        axes.plot(
            lost, np.zeros(len(lost)), transform=axes.get_xaxis_transform(), linestyle="none", marker="|",
            color=LOST, markersize=6, markeredgewidth=0.8, rasterized=True, label="diverged",
        )  # fmt: skip
    diverged = f", {len(lost):,} diverged" if len(lost) else ""
    axes.set_title(f"{condition}\n", loc="left", fontsize=10)
    axes.annotate(
        f"{len(run):,} trials{diverged}", (0, 1), (0, 6), xycoords="axes fraction", textcoords="offset points",
        fontsize=9, color=LOST if len(lost) else "0.3", ha="left", va="bottom",
    )  # fmt: skip


def _size_of(trials: int) -> float:
    """Diameter of a dot, points: the more there are, the smaller."""
    return float(np.clip(60.0 / np.sqrt(trials), 1.4, 3.0))


def _alpha_of(trials: int) -> float:
    """Opacity of a dot: the more there are, the less of it is seen, so that the cloud shows where they are dense."""
    return float(np.clip(6_000 / trials, 0.15, 0.8))


def _wobble(axes: Axes, run: pd.DataFrame, named: bool) -> None:
    """The factor of each epoch, which is one for all that wobble; above it what wobbles, if that is to be named."""
    epochs = run.drop_duplicates("epoch")
    mine = _wobbling(epochs)
    factor = epochs[mine[0]] if mine else np.ones(len(epochs))
    axes.axhline(1.0, color="0.8", linewidth=0.8, zorder=0)
    axes.plot(epochs["epoch"], factor, color=FAINT, linewidth=0.8, label=" and ".join(mine))
    if named and mine:
        axes.annotate(
            " and ".join(mine), (0, 1), (0, 2), xycoords="axes fraction", textcoords="offset points", fontsize=8,
            color="0.3", ha="left", va="bottom",
        )  # fmt: skip


def _wobbling(run: pd.DataFrame) -> list[str]:
    return [name for name in DIMENSIONS if (run[name] != 1.0).any()]


def _dress(clouds: Sequence[Axes], wobbles: Sequence[Axes], performance: str, dimensions: Sequence[str]) -> None:
    last = max(axes.dataLim.x1 for axes in wobbles)
    factor = f"{dimensions[0]}\nfactor" if len(dimensions) == 1 else "factor"
    for place, (cloud, wobble) in enumerate(zip(clouds, wobbles, strict=True)):
        first = place % MOST_COLUMNS == 0
        dress(cloud, "", performance if first else "")
        dress(wobble, "epoch", factor if first else "", grid="")
        over_epochs(wobble, last)
        for axes in (cloud, wobble):
            axes.tick_params(labelleft=first)
        wobble.tick_params(labelbottom=True)
    if not dimensions:
        wobbles[0].set_ylim(0.9, 1.1)


def _says(seed: int, ends: pd.Series, performance: pd.Series) -> str:
    dashes = ", dashed: the wobble ends" if ends.notna().any() else ""
    ticks = ", ticks at the lower edge: diverged" if performance.isna().any() else ""
    return f"all trials of the run with seed {seed}{dashes}{ticks}"
