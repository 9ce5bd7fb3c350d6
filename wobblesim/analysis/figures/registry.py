"""The figures by name, each in a file of its own with one contract: `draw(results, choice) -> Drawing`."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import pandas as pd

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.style import Drawing
from wobblesim.analysis.statistics import baseline
from wobblesim.analysis.tables import Results
from wobblesim.study.errors import StoreError


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

    def shown(self, results: Results) -> list[str]:
        """The conditions shown, in the order of the study.

        Raises
        ------
        StoreError
            If one has no run.
        """
        for name in self.conditions or ():
            results.require(name)
        return [name for name in results.conditions if self.conditions is None or name in self.conditions]

    def reference(self, results: Results) -> str:
        """The condition that others are compared with.

        Raises
        ------
        StoreError
            If it has no run.
        """
        if self.baseline is None:
            return baseline(results.conditions)
        results.require(self.baseline)
        return self.baseline

    def typical_seed(self, results: Results, conditions: Sequence[str]) -> int:
        """The seed of the single runs that are shown, the same for all conditions, so that the runs are pairs.

        It is the one asked for. Without one, it is the seed with the median gain among those with a score in all
        conditions: the mean of the others' performance minus the baseline's, or the mean performance where no
        baseline is shown. Of two in the middle it is the lower gain; if no seed has a score everywhere, the least seed.

        Raises
        ------
        FigureError, StoreError
            If a condition has no run of the seed, or no seed is common to all.
        """
        if self.seed is not None:
            for name in conditions:
                results.require(name, self.seed)
            return self.seed
        common = set.intersection(*(set(results.seeds(name)) for name in conditions))
        if not common:
            raise FigureError("no seed has a run in every condition shown; choose conditions that share one")
        gains = self._gains(results, conditions).reindex(sorted(common)).dropna().sort_values(kind="stable")
        return int(gains.index[(len(gains) - 1) // 2]) if len(gains) else min(common)

    def _gains(self, results: Results, conditions: Sequence[str]) -> pd.Series:
        """By seed, the mean performance of conditions, minus that of the baseline if it is among them."""
        runs = results.runs("condition", "seed", "performance").pivot(
            index="seed", columns="condition", values="performance"
        )
        reference = self.reference(results)
        others = [name for name in conditions if name != reference] or list(conditions)
        mean = runs[others].mean(axis="columns", skipna=False)
        return mean - runs[reference] if reference in conditions and reference not in others else mean


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
    """Names of figures, groups replaced by what they stand for, each once.

    Raises
    ------
    FigureError
        If there is no such figure, with the nearest name.
    """
    for name in names:
        if name not in FIGURES and name not in GROUPS:
            close = difflib.get_close_matches(name, [*FIGURES, *GROUPS], n=1)
            hint = f"did you mean {close[0]}?" if close else f"there are {', '.join([*FIGURES, *GROUPS])}"
            raise FigureError(f"there is no figure {name!r}; {hint}")
    return tuple(dict.fromkeys(one for name in names for one in GROUPS.get(name, (name,))))


def draw(name: str, results: Results, choice: Choice | None = None) -> Drawing:
    """Draw a figure of `FIGURES`.

    Raises
    ------
    FigureError
        If there is no such figure, or the study does not have what it shows; the sentence says what is missing.
    StoreError
        If a condition or a run that is asked for is not there.
    """
    if name not in FIGURES:
        expand([name])
        raise FigureError(f"{name} stands for several figures: {', '.join(GROUPS[name])}; draw them one by one")
    return _module(name).draw(results, choice or Choice())


def lacking(name: str, results: Results, choice: Choice | None = None) -> str | None:
    """What keeps a figure of `FIGURES` from being drawn, as a sentence; None if nothing does.

    A module may have a function ``check(results, choice)`` that raises what ``draw`` would for want of data, without
    the work; one that has none is drawn.
    """
    module = _module(name)
    try:
        getattr(module, "check", module.draw)(results, choice or Choice())
    except (FigureError, StoreError) as error:
        return str(error)
    return None


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"wobblesim.analysis.figures.{FIGURES[name].home}")
