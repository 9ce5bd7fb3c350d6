"""The way of the search on the plane in which it varies most (the paper's figure 4 A)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from wobblesim.analysis.exploration import principal_components, search_distances, split_of
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.scatter import require_kept
from wobblesim.analysis.figures.style import MOST_COLUMNS, SEQUENTIAL, Drawing, count, dress, new_figure, panels
from wobblesim.analysis.tables import Results

MARKS = {"start": "v", "half-way": "o", "end": "*"}
"""Shapes of the marks, those of the paper: a large inverted triangle, a disk and a star."""

RED, SIZES = "#D40000", {"start": 11.0, "half-way": 8.0, "end": 14.0}


class Map(NamedTuple):
    """The map of a run.

    Attributes
    ----------
    rows : DataFrame
        Behaviours that were the best of their epoch, and their ancestors, with ``component_1`` and ``component_2``; of
        one tree, that of the final best.
    left_out : int
        Epochs whose best behaviour is of another tree.
    edges : (n_edges, 2, 2)
        Segments from a parent to a child that differs from it.
    born : (n_edges,)
        Epochs of the children.
    explained : (2,)
        Share of the variance along each component.
    before, after : float
        Search distances along the ancestry of the final best behaviour.
    split : int
        The epoch between them.
    """

    rows: pd.DataFrame
    left_out: int
    edges: NDArray[np.float64]
    born: NDArray[np.int64]
    explained: NDArray[np.float64]
    before: float
    after: float
    split: int


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw a panel a condition: the best behaviour of each epoch and its ancestors, of one run, and who made whom.

    The run is that of `Choice.typical_seed`. A run begins with many behaviours, the paper's with one: what does not
    descend from the same one as the final best, as the best of the first epochs may not, is left out. Each panel has
    principal components of its own, of all distinct behaviours that are shown. A line goes from a behaviour to one that
    was made from it, coloured by epoch. Red marks lie on the ancestry of the final best behaviour: its ancestor in
    epoch 0, that where the wobble ends (half-way for a fixed robot), and itself. The title says the search distance
    between them, a sum of Euclidean distances of genotypes, and in its second line the mean over the runs with its
    99 % interval.

    The table has a row for each behaviour in each of its epochs: ``condition``, ``seed``, ``epoch``, ``slot``,
    ``parent`` (slot in the epoch before), ``performance`` in body lengths, ``best`` of the epoch, ``final`` for the
    final best and its ancestors, ``component_1``, ``component_2``, and which ``mark`` it has.
    """
    check(results, choice)
    conditions = choice.shown(results)
    seed = choice.typical_seed(results, conditions)
    maps = {name: map_of(results, name, seed) for name in conditions}
    means = search_distances(results).set_index("condition")
    columns, rows = min(len(maps), MOST_COLUMNS), -(-len(maps) // MOST_COLUMNS)
    figure = new_figure(1.2 + {1: 5.0, 2: 4.2, 3: 3.6}.get(columns, 3.2) * columns, 0.8 + 4.2 * rows)
    all_panels = panels(figure, len(maps))
    colors = Normalize(0, max(int(found.rows["epoch"].max()) for found in maps.values()))
    for axes, (name, found) in zip(all_panels, maps.items(), strict=True):
        _panel(axes, found, colors)
        _dress(axes, found, f"{name}: {_distances(found)}", means.loc[name])
    figure.colorbar(all_panels[0].collections[0], ax=all_panels, label="epoch", shrink=0.7, aspect=30)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    figure.suptitle(
        _says(seed, [found.left_out for found in maps.values()]), x=0.01, ha="left", fontsize=9, color="0.3"
    )
    table = pd.concat([found.rows.assign(condition=name, seed=seed) for name, found in maps.items()], ignore_index=True)
    return Drawing(figure, table[[*COLUMNS]])


COLUMNS = (
    "condition",
    "seed",
    "epoch",
    "slot",
    "parent",
    "performance",
    "best",
    "final",
    "component_1",
    "component_2",
    "mark",
)


def check(results: Results, choice: Choice) -> None:
    """Refuse what lacks behaviours, or has too many conditions.

    Raises
    ------
    FigureError
    """
    require_kept(results, choice, "behaviours", "behaviours are shown as points")


def map_of(results: Results, condition: str, seed: int) -> Map:
    """Work out the map of a run."""
    forest = results.lineage(*OF_LINEAGE, condition=condition, seed=seed)
    root = _roots(forest)
    mine = root == root[forest["final"]][-1]
    rows = forest[mine].reset_index(drop=True)
    run = results.runs("condition", "seed", "path_before", "path_after", "wobble.end", "learning.epochs")
    run = run[(run["condition"] == condition) & (run["seed"] == seed)].iloc[0]
    split = min(split_of(run), int(rows["epoch"].max()))
    # A behaviour that is kept for many epochs is one point: it would weigh more than others.
    new = ((rows["epoch"] == 0) | (rows["modification"] > 0.0)).to_numpy()
    genotypes = np.stack(list(rows.pop("genotype")))
    _, axes, explained = principal_components(genotypes[new])
    scores = (genotypes - genotypes[new].mean(axis=0)) @ axes.T
    rows[["component_1", "component_2"]] = scores
    child = np.flatnonzero(rows["modification"].to_numpy() > 0.0)
    edges = np.stack([scores[_parents(rows, child)], scores[child]], axis=1)
    rows["mark"] = _marks(rows, split)
    born = rows["epoch"].to_numpy(np.int64)[child]
    left_out = int(forest["best"][~mine].sum())
    return Map(rows, left_out, edges, born, explained, float(run["path_before"]), float(run["path_after"]), split)


OF_LINEAGE = ("epoch", "slot", "parent", "performance", "best", "final", "genotype", "modification")


def _roots(rows: pd.DataFrame) -> NDArray[np.intp]:
    """Where the ancestor in epoch 0 of each row stands."""
    ancestor = np.arange(len(rows))
    later = np.flatnonzero(rows["epoch"] > 0)
    ancestor[later] = _parents(rows, later)
    # Parents of parents of parents: twice as far back each time.
    while not np.array_equal(further := ancestor[ancestor], ancestor):
        ancestor = further
    return ancestor


def _parents(rows: pd.DataFrame, child: NDArray[np.intp]) -> NDArray[np.intp]:
    """Where the parents of some rows stand."""
    places = pd.Series(np.arange(len(rows)), index=pd.MultiIndex.from_frame(rows[["epoch", "slot"]]))
    of = rows.iloc[child]
    return places.loc[list(zip(of["epoch"] - 1, of["parent"], strict=True))].to_numpy()


def _marks(rows: pd.DataFrame, split: int) -> NDArray[np.str_]:
    """The mark of each row: start, half-way and end of the ancestry of the final best, the last that applies."""
    final, epoch = rows["final"], rows["epoch"]
    places = [final & (epoch == rows["epoch"].max()), final & (epoch == split), final & (epoch == 0)]
    return np.select(places, ["end", "half-way", "start"], "")


# --- the picture -----------------------------------------------------------------------------------------------------


def _panel(axes: Axes, found: Map, colors: Normalize) -> None:
    axes.add_collection(
        LineCollection(list(found.edges), array=found.born, cmap=SEQUENTIAL, norm=colors, linewidths=0.7, alpha=0.9)
    )
    for name, row in found.rows[found.rows["mark"] != ""].set_index("mark").iterrows():
        axes.plot(
            [row["component_1"]], [row["component_2"]], marker=MARKS[str(name)], markersize=SIZES[str(name)],
            color=RED, markeredgecolor="white", markeredgewidth=0.8, linestyle="none", zorder=3, label=str(name),
        )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.autoscale_view()


def _dress(axes: Axes, found: Map, title: str, mean: pd.Series) -> None:
    first, second = (f"component {place + 1}{_share(share)}" for place, share in enumerate(found.explained))
    dress(axes, first, second, grid="")
    axes.set_title(f"{title}\n{_mean_distances(mean)}", loc="left", fontsize=9)
    axes.xaxis.label.set_fontsize(9)
    axes.yaxis.label.set_fontsize(9)
    axes.tick_params(labelsize=8)


def _share(explained: float) -> str:
    return f": {100 * explained:.0f} % of the variance" if np.isfinite(explained) else ""


def _distances(found: Map) -> str:
    return f"{found.before:.2f} to epoch {found.split}, then {found.after:.2f}"


def _mean_distances(mean: pd.Series) -> str:
    if mean["n"] == 1:
        return "the only run"
    before, after = (f"{mean[name]:.2f} ± {mean[f'{name}_half_width']:.2f}" for name in ("before", "after"))
    return f"{int(mean['n'])} runs: {before}, then {after}"


def _says(seed: int, left_out: Sequence[int]) -> str:
    some = f", but for {count(left_out, 'epoch')} of other descent" if any(left_out) else ""
    return (
        f"the best behaviour of each epoch and its ancestors{some}, run with seed {seed}\n"
        "titles: search distances of this run, and means with 99 % confidence"
    )


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], marker=shape, markersize=0.8 * SIZES[name], color=RED, linestyle="none", label=name)
        for name, shape in MARKS.items()
    ]
