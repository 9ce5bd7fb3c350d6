"""The starfish, built by hand from the words of the design (section 3): the referee of ``wobblesim.starfish``."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, pi, sin, sqrt

import numpy as np

STIFFNESS = {"diagonal": 100_000.0, "side": 3_000.0, "width": 12_000.0, "center": 500_000.0, "tip": 500_000.0}


@dataclass
class Drawing:
    """A robot as lists, in the order of construction."""

    nodes: list[np.ndarray] = field(default_factory=list)
    springs: list[tuple[int, int]] = field(default_factory=list)
    stiffness: list[float] = field(default_factory=list)
    muscles: list[tuple[int, int, float]] = field(default_factory=list)  # (spring, group, sign)
    cells: list[tuple[int, int, int, int]] = field(default_factory=list)

    def node(self, position) -> int:
        """Add a node; returns its number."""
        self.nodes.append(np.array(position, dtype=float))
        return len(self.nodes) - 1

    def spring(self, a: int, b: int, stiffness: float) -> int:
        """Add a spring; returns its number."""
        self.springs.append((a, b))
        self.stiffness.append(stiffness)
        return len(self.springs) - 1

    def positions(self) -> np.ndarray:
        """Nodes (nodes, 2) in u, the lowest on the floor."""
        positions = np.array(self.nodes)
        positions[:, 1] -= positions[:, 1].min()
        return positions

    def lengths(self) -> np.ndarray:
        """Spring lengths as built (springs,) in u."""
        ends = np.array(self.nodes)[np.array(self.springs)]
        return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def draw(
    arms=6, sections=8, height=40.0, width=30.0, center_side=30.0, groups_per_arm=2, stiffness=None, size=1.0
) -> Drawing:
    """Draw a starfish; `size` scales the heights of sections and tips before building."""
    k = STIFFNESS | (stiffness or {})
    drawing = Drawing()
    draw_center(drawing, arms, center_side, k["center"])
    for arm in range(arms):
        base = (arm, (arm - 1) % arms)
        for section in range(sections):
            group = arm * groups_per_arm + group_of(section, sections, groups_per_arm)
            base = draw_section(drawing, base, height * size, width, group, k)
        draw_tip(drawing, base, height * size, k["tip"])
    return drawing


def draw_center(drawing: Drawing, n: int, side: float, k: float) -> None:
    """A regular polygon, counter-clockwise from 90 deg + 360 deg / n, with springs to i+1, i+2 and i+n//3."""
    radius = side / sqrt(2 * (1 - cos(2 * pi / n)))
    for i in range(n):
        angle = pi / 2 + 2 * pi / n * (i + 1)
        drawing.node((radius * cos(angle), radius * sin(angle)))
    for i in range(n):
        for ahead in (1, 2, n // 3):
            drawing.spring((i + ahead) % n, i, k)


def frame(drawing: Drawing, base: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Middle, direction left to right, its left normal ("up"), and width of a base."""
    left, right = (drawing.nodes[i] for i in base)
    width = float(np.linalg.norm(right - left))
    along = (right - left) / width
    return (left + right) / 2, along, np.array([-along[1], along[0]]), width


def draw_section(drawing: Drawing, base, height: float, width: float, group: int, k) -> tuple[int, int]:
    """Two nodes and five springs on a base; returns the top, which is the next base."""
    left, right = base
    middle, along, up, base_width = frame(drawing, base)
    rise = sqrt(height**2 - ((base_width - width) / 2) ** 2)
    top_left = drawing.node(middle + rise * up - width / 2 * along)
    top_right = drawing.node(middle + rise * up + width / 2 * along)
    drawing.spring(left, top_right, k["diagonal"])
    drawing.spring(right, top_left, k["diagonal"])
    drawing.muscles.append((drawing.spring(left, top_left, k["side"]), group, -1.0))
    drawing.muscles.append((drawing.spring(right, top_right, k["side"]), group, 1.0))
    drawing.spring(top_left, top_right, k["width"])
    drawing.cells.append((left, right, top_right, top_left))
    return top_left, top_right


def draw_tip(drawing: Drawing, base, height: float, k: float) -> None:
    """One node above the middle of the last base."""
    middle, _, up, _ = frame(drawing, base)
    tip = drawing.node(middle + height * up)
    for corner in base:
        drawing.spring(corner, tip, k)


def group_of(section: int, sections: int, groups: int) -> int:
    """Group of a section within its arm: as even as possible, the first groups take the odd ones."""
    share, odd = divmod(sections, groups)
    sizes = [share + (g < odd) for g in range(groups)]
    return int(np.searchsorted(np.cumsum(sizes), section, side="right"))
