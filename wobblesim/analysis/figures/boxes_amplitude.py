"""Boxplots of the final performance by amplitude and dimension of the wobble (the paper's figure 3 B)."""

from __future__ import annotations

from wobblesim.analysis.figures.boxplot import Layout, box_figure, grouped, require_alone, require_varied, settings_of
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import WIDTH, Drawing
from wobblesim.analysis.tables import Results

AMPLITUDE, DIMENSION = "wobble.amplitude", "wobble.dimension"


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw boxes by amplitude, those of the dimensions side by side, and the fixed robot at the left.

    The marks and the table are those of `wobblesim.analysis.figures.boxplot.box_figure`.
    """
    return box_figure(results, choice, _layout(results, choice), WIDTH)


def check(results: Results, choice: Choice) -> None:
    """Refuse a study in which the amplitude does not vary, or other settings than the dimension do.

    Raises
    ------
    FigureError
    """
    _layout(results, choice)


def _layout(results: Results, choice: Choice) -> Layout:
    settings = settings_of(results, choice)
    require_varied(settings, AMPLITUDE)
    require_alone(settings, AMPLITUDE, along=[DIMENSION])
    return grouped(settings, AMPLITUDE, "amplitude (part of the adult's value)", hue=DIMENSION)
