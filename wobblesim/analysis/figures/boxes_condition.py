"""Boxplots of the final performance of each condition of any study."""

from __future__ import annotations

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.boxplot import FILLS, UNWOBBLED, Layout, Place, box_figure, box_width, settings_of
from wobblesim.analysis.figures.registry import Choice
from wobblesim.analysis.figures.style import WIDTH, Drawing
from wobblesim.analysis.tables import Results

MOST_BOXES = 60
"""Conditions that fit beside each other."""

INCHES_A_BOX = 0.3


def draw(results: Results, choice: Choice) -> Drawing:
    """Draw a box a condition and of the baseline, in the order of the study; those without a wobble are grey.

    The marks and the table are those of `wobblesim.analysis.figures.boxplot.box_figure`.
    """
    check(results, choice)
    wobbles = settings_of(results, choice)["wobble.amplitude"].notna()
    width = box_width(len(wobbles))
    places = [
        Place(str(name), float(x), width, FILLS[1] if wobbled else UNWOBBLED)
        for x, (name, wobbled) in enumerate(wobbles.items())
    ]
    layout = Layout(places, {place.x: place.condition for place in places}, "")
    return box_figure(results, choice, layout, max(WIDTH, 1.0 + INCHES_A_BOX * len(places)))


def check(results: Results, choice: Choice) -> None:
    """Refuse more conditions than fit.

    Raises
    ------
    FigureError
    """
    shown = {*choice.shown(results), choice.reference(results)}
    if len(shown) > MOST_BOXES:
        raise FigureError(
            f"each condition is a box, and {len(shown):,} are more than the {MOST_BOXES} that fit; choose some with "
            "--condition"
        )
