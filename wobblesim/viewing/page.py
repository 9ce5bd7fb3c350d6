"""Pages that need nothing but themselves: styles, scripts and data of the package put into one HTML file.

Also the colours, which pages and films share.
"""

from __future__ import annotations

import functools
import importlib.resources
import json
from collections.abc import Mapping
from typing import Any

PACKAGE, FOLDER = "wobblesim.viewing", "templates"

STRAIN = 0.2
"""Part of its length at rest by which a muscle is longer or shorter at the ends of the colour scale."""

COLORS: Mapping[str, Mapping[str, Any]] = {
    "light": {
        "sky": "#ffffff",
        "ground": "#eef0f2",
        "line": "#6b7280",
        "text": "#4b5563",
        "spring": "#9aa3af",
        "node": "#4b5563",
        "skin": "#f1f3f5",
        "trail": "#7c8794",
        "muscle": ["#08519c", "#5b94cc", "#b4bac2", "#e08a4f", "#a63603"],
    },
    "dark": {
        "sky": "#14171c",
        "ground": "#1f242b",
        "line": "#8b95a3",
        "text": "#aab3bf",
        "spring": "#5f6875",
        "node": "#aab3bf",
        "skin": "#1d2229",
        "trail": "#7c8794",
        "muscle": ["#6bb8ff", "#4a7fb5", "#59616d", "#b46d3c", "#ff9d57"],
    },
}
"""What is drawn in which colour.

``muscle`` goes in equal steps from longer by `STRAIN` through at rest to shorter by `STRAIN`: blue, grey and orange,
which people with any colour vision tell apart, the ends further from the background than the middle.
"""


def muscle_color(contraction: float, scheme: str = "light") -> tuple[int, int, int]:
    """Red, green and blue (0 to 255) of a muscle that is shorter than at rest by this part of its length.

    Linear between the colours of the scale, halves rounded up; at its ends beyond them.
    """
    stops = _stops(scheme)
    place = (min(max(contraction / STRAIN, -1.0), 1.0) + 1.0) / 2.0 * (len(stops) - 1)
    first = min(int(place), len(stops) - 2)
    part = place - first
    red, green, blue = (int(a + (b - a) * part + 0.5) for a, b in zip(stops[first], stops[first + 1], strict=True))
    return red, green, blue


@functools.cache
def _stops(scheme: str) -> list[tuple[int, int, int]]:
    return [rgb(stop) for stop in COLORS[scheme]["muscle"]]


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#rrggbb``."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


@functools.cache
def asset(name: str) -> str:
    """The text of a script, style or template of the package."""
    return (importlib.resources.files(PACKAGE) / FOLDER / name).read_text(encoding="utf-8")


def render(template: str, **values: Any) -> str:
    """Fill in a template of the package; values are escaped unless the template marks them safe."""
    return _environment().get_template(template).render(**values)


@functools.cache
def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader(PACKAGE, FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def embedded(data: Any) -> str:
    """Data as JSON that may stand in a script element: no text in it can end the element.

    Raises
    ------
    ValueError
        If a number in it is not finite, for JSON has no such numbers.
    """
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
