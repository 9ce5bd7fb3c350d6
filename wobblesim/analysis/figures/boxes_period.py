"""Boxplots of the final performance by period and form of the wobble (the paper's figure 3 A)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from wobblesim.analysis.figures.boxplot import Layout, box_figure, grouped, require_alone, require_varied, settings_of
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import WIDTH, Drawing
from wobblesim.analysis.tables import Results

PERIOD, FORM = "wobble.period", "form"
OF_FORM = ("wobble.mean", "wobble.upper_bound", "wobble.amplitude")
"""Settings in which forms may differ, each form with values of its own."""


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw boxes by period, the forms of the wobble side by side, and the fixed robot at the left.

    A wobble is ``regular`` around the adult; ``paused`` with an upper bound, which is a rest of half of each period;
    ``shifted`` around another mean (Benureau & Tani 2022, section III-A). The marks and the table are those of
    `wobblesim.analysis.figures.boxplot.box_figure`.
    """
    return box_figure(results, choice, _layout(results, choice), WIDTH)


def check(results: Results, choice: Choice) -> None:
    """Refuse a study in which the period does not vary, or other settings than those of the form do.

    Raises
    ------
    FigureError
    """
    _layout(results, choice)


def _layout(results: Results, choice: Choice) -> Layout:
    settings = settings_of(results, choice)
    settings[FORM] = _forms(settings)
    require_varied(settings, PERIOD)
    require_alone(settings, PERIOD, along=[FORM, *OF_FORM])
    for _, alike in settings[settings[PERIOD].notna()].groupby(FORM):
        require_alone(alike, PERIOD)
    return grouped(settings, PERIOD, "period (epochs)", hue=FORM)


def _forms(settings: pd.DataFrame) -> np.ndarray:
    """The form of each condition's wobble; of a fixed robot, ``regular`` says nothing."""
    paused, shifted = settings["wobble.upper_bound"].notna(), settings["wobble.mean"].fillna(1.0) != 1.0
    return np.select([shifted, paused], ["shifted", "paused"], "regular")
