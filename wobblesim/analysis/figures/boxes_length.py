"""Boxplots of the final performance by the length of the wobble (the paper's figure 3 C)."""

from __future__ import annotations

from wobblesim.analysis.figures.boxplot import Layout, box_figure, grouped, require_alone, require_varied, settings_of
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import WIDTH, Drawing
from wobblesim.analysis.tables import Results

END, DECAY, DIMENSION = "wobble.end", "wobble.decay_start", "wobble.dimension"


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw boxes by the end of the wobble, those of the dimensions side by side, and the fixed robot at the left.

    The marks and the table are those of `wobblesim.analysis.figures.boxplot.box_figure`.
    """
    return box_figure(results, choice, _layout(results, choice), WIDTH)


def check(results: Results, choice: Choice) -> None:
    """Refuse a study in which the length does not vary, or other settings than its decay and the dimension do.

    Raises
    ------
    FigureError
    """
    _layout(results, choice)


def _layout(results: Results, choice: Choice) -> Layout:
    settings = settings_of(results, choice)
    require_varied(settings, END)
    require_alone(settings, END, along=[DECAY, DIMENSION])
    return grouped(settings, END, "length of the wobble (epochs)", hue=DIMENSION)
