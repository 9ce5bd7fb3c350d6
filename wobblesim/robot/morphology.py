"""Factors on the adult robot: what wobbling changes between epochs."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Morphology:
    """Factors on the adult's characteristics, each 1 for the adult.

    Parameters
    ----------
    mass : float
        Factor on the mass of every node.
    stiffness : float
        Factor on the stiffness of the muscles (and of no other spring).
    size : float
        Factor on the heights of sections and tips; widths and centre stay.
    gravity : float
        Factor on gravity.

    Raises
    ------
    ValueError
        If a factor is not a finite number above 0.
    """

    mass: float = 1.0
    stiffness: float = 1.0
    size: float = 1.0
    gravity: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            factor = getattr(self, field.name)
            if not (math.isfinite(factor) and factor > 0):
                raise ValueError(f"the {field.name} factor is {factor}: a morphology needs finite factors above 0")
