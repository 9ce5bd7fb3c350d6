"""The paper's robot: a hexagon with six arms of eight sections, 108 nodes and 270 springs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from wobblesim.robot.body import Body

STIFFNESS: Mapping[str, float] = {
    "diagonal": 100_000.0,
    "side": 3_000.0,
    "width": 12_000.0,
    "center": 500_000.0,
    "tip": 500_000.0,
}


@dataclass
class _Builder:
    """Nodes and springs in the order in which they are made: it fixes numbers and `impulse`'s bits."""

    stiffness: Mapping[str, float]
    nodes: list[tuple[float, float]] = field(default_factory=list)
    springs: list[tuple[int, int]] = field(default_factory=list)
    spring_stiffness: list[float] = field(default_factory=list)
    muscles: list[tuple[int, int, float]] = field(default_factory=list)
    cells: list[tuple[int, int, int, int]] = field(default_factory=list)

    def node(self, x: float, y: float) -> int:
        self.nodes.append((x, y))
        return len(self.nodes) - 1

    def spring(self, a: int, b: int, material: str) -> int:
        self.springs.append((a, b))
        self.spring_stiffness.append(self.stiffness[material])
        return len(self.springs) - 1

    def frame(self, left: int, right: int) -> tuple[float, float, float, float, float]:
        """Middle of a base, the unit vector left -> right, and its length; "up" is the left normal."""
        (xl, yl), (xr, yr) = self.nodes[left], self.nodes[right]
        length = math.sqrt((xr - xl) ** 2 + (yr - yl) ** 2)
        return 0.5 * (xl + xr), 0.5 * (yl + yr), (xr - xl) / length, (yr - yl) / length, length

    def center(self, n: int, side: float) -> None:
        """A regular polygon, counter-clockwise; for n = 6 the last two springs of each node coincide."""
        radius = side / math.sqrt(2.0 * (1.0 - math.cos(2.0 * math.pi / n)))
        for i in range(n):
            angle = math.pi / 2 + 2.0 * math.pi * (i + 1) / n
            self.node(radius * math.cos(angle), radius * math.sin(angle))
        for i in range(n):
            for step in (1, 2, n // 3):
                self.spring((i + step) % n, i, "center")

    def section(self, left: int, right: int, height: float, width: float, group: int) -> tuple[int, int]:
        """One section on the base (left, right); returns the base of the next."""
        x, y, ux, uy, base = self.frame(left, right)
        rise = math.sqrt(height**2 - ((base - width) / 2) ** 2)  # so that the sides are `height` long
        x, y = x - rise * uy, y + rise * ux
        top_left = self.node(x - 0.5 * width * ux, y - 0.5 * width * uy)
        top_right = self.node(x + 0.5 * width * ux, y + 0.5 * width * uy)
        self.spring(left, top_right, "diagonal")
        self.spring(right, top_left, "diagonal")
        self.muscles.append((self.spring(left, top_left, "side"), group, -1.0))
        self.muscles.append((self.spring(right, top_right, "side"), group, +1.0))
        self.spring(top_left, top_right, "width")
        self.cells.append((left, right, top_right, top_left))
        return top_left, top_right

    def tip(self, left: int, right: int, height: float) -> None:
        x, y, ux, uy, _ = self.frame(left, right)
        tip = self.node(x - height * uy, y + height * ux)
        self.spring(left, tip, "tip")
        self.spring(right, tip, "tip")
        self.cells.append((left, right, tip, tip))


def _group_of_section(sections: int, groups: int) -> list[int]:
    """Split sections over groups as evenly as possible, the first groups taking the odd ones."""
    return [group for group, part in enumerate(np.array_split(np.arange(sections), groups)) for _ in part]


def starfish(
    arms: int = 6,
    sections: int = 8,
    height: float = 40.0,
    width: float = 30.0,
    center_side: float = 30.0,
    groups_per_arm: int = 2,
    node_mass: float = 1.0,
    friction: float = 0.5,
    stiffness: Mapping[str, float] | None = None,
    damping_ratio: float = 1.0,
) -> Body:
    """Build the soft starfish of the paper (Benureau & Tani 2022, section II.A).

    Parameters
    ----------
    arms : int
        At least 3.
    sections : int
        Sections an arm, at least 1; a tip closes each arm.
    height, width, center_side : float
        Height and width of a section, side of the centre polygon, u.
    groups_per_arm : int
        Motor groups an arm, from proximal to distal.
    node_mass, friction, damping_ratio : float
        Of every node; of every node on the floor; of every spring.
    stiffness : mapping, optional
        Any of ``diagonal, side, width, center, tip`` (mass unit/s²); the others keep their defaults.

    Returns
    -------
    Body
        With its lowest node on the floor, at rest.

    Raises
    ------
    ValueError
        If a number is out of its range, or a material has no such name.
    """
    materials = {**STIFFNESS, **(stiffness or {})}
    if unknown := set(materials) - set(STIFFNESS):
        raise ValueError(f"no stiffness named {min(unknown)!r}: the materials are {', '.join(STIFFNESS)}")
    if arms < 3 or sections < 1 or not 1 <= groups_per_arm <= sections:
        raise ValueError("a starfish needs 3 arms or more, 1 section or more, and 1 group to one a section on each arm")
    if not min(height, width, center_side) > 0:
        raise ValueError("height, width and center_side must be > 0 u")
    return _Plan(
        arms, sections, height, width, center_side, groups_per_arm, node_mass, friction, materials, damping_ratio
    ).build(1.0)


@dataclass(frozen=True)
class _Plan:
    """The parameters of `starfish`, from which the robot is rebuilt at any size."""

    arms: int
    sections: int
    height: float
    width: float
    center_side: float
    groups_per_arm: int
    node_mass: float
    friction: float
    stiffness: Mapping[str, float]
    damping_ratio: float

    def build(self, size: float) -> Body:
        """The starfish with its heights times `size`."""
        height = size * self.height
        if not height > abs(self.center_side - self.width) / 2:
            raise ValueError(f"a section {height:g} u high cannot stand on a centre of side {self.center_side:g} u")
        make = _Builder(self.stiffness)
        make.center(self.arms, self.center_side)
        of_section = _group_of_section(self.sections, self.groups_per_arm)
        for arm in range(self.arms):
            left, right = arm, (arm - 1) % self.arms
            for group in of_section:
                left, right = make.section(left, right, height, self.width, arm * self.groups_per_arm + group)
            make.tip(left, right, height)
        position = np.array(make.nodes)
        position[:, 1] -= position[:, 1].min()
        return Body.from_arrays(
            position,
            make.springs,
            stiffness=make.spring_stiffness,
            damping_ratio=self.damping_ratio,
            mass=self.node_mass,
            friction=self.friction,
            muscles=make.muscles,
            center=np.arange(self.arms),
            cells=make.cells,
            build=self.build,
        )
