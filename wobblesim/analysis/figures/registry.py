"""The figures by name, each in a file of its own with one contract: `draw(results, choice) -> Drawing`."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from wobblesim.analysis.figures.style import Drawing
from wobblesim.analysis.tables import Results


@dataclass(frozen=True)
class Choice:
    """What a figure is made of, where it shows a part of a study.

    Parameters
    ----------
    baseline : str, optional
        Condition that others are compared with; see `wobblesim.analysis.statistics.baseline`.
    conditions : tuple of str, optional
        Conditions shown; all if none is given.
    seed : int, optional
        Run shown where a figure shows single runs; each figure says which it takes by default.
    """

    baseline: str | None = None
    conditions: tuple[str, ...] | None = None
    seed: int | None = None


class Entry(NamedTuple):
    """A figure: where it is made, and what it shows in a few words."""

    home: str
    says: str


FIGURES = {
    "figure-2a": Entry("scatter", "all trials of a run, its wobble beneath"),
    "figure-2b": Entry("learning", "the best trial of each epoch, mean with 99 % band"),
    "figure-3a": Entry("boxes_period", "final performance by period, of the regular, paused and shifted wobble"),
    "figure-3b": Entry("boxes_amplitude", "final performance by amplitude and dimension"),
    "figure-3c": Entry("boxes_length", "final performance by length of the wobble"),
    "boxes": Entry("boxes_condition", "final performance of each condition"),
    "figure-4a": Entry("search_map", "principal components of the search, with distances"),
    "figure-4b": Entry("search_distance", "moving average of the search distance of an epoch"),
    "heat-map": Entry("heat_map", "final performance over period and amplitude"),
    "exploration": Entry("exploring", "final performance against the search distance"),
    "pairs": Entry("pairs", "final performance of runs with the same seed, joined by lines"),
    "generalisation": Entry("generalisation", "the learnt gait on the whole range of the wobbled dimension"),
}
"""Every figure, in the order in which `all` draws them: a module of this package with a function `draw`."""

GROUPS = {
    "figure-2": ("figure-2a", "figure-2b"),
    "figure-3": ("figure-3a", "figure-3b", "figure-3c"),
    "figure-4": ("figure-4a", "figure-4b"),
    "all": tuple(FIGURES),
}
"""Names that stand for several figures."""


def expand(names: Sequence[str]) -> tuple[str, ...]:
    """Names of figures, groups replaced by what they stand for, each once."""
    return tuple(dict.fromkeys(one for name in names for one in GROUPS.get(name, (name,))))


def draw(name: str, results: Results, choice: Choice | None = None) -> Drawing:
    """Draw a figure of `FIGURES`.

    Raises
    ------
    FigureError
        If the study does not have what the figure shows; the sentence says what is missing.
    """
    module = importlib.import_module(f"wobblesim.analysis.figures.{FIGURES[name].home}")
    return module.draw(results, choice or Choice())
