"""How much of a gait's end point is left when next to nothing is changed: no step can do better than that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wobblesim.numerics.reference import by_steps, displacement
from wobblesim.numerics.scenes import Case, long_gait
from wobblesim.physics.scene import Physics
from wobblesim.robot.morphology import Morphology

CHANGE = 1e-12
"""Relative change of all masses."""

HORIZONS = (5.0, 20.0, 60.0)
SHORT_HORIZONS = (5.0, 10.0)


@dataclass(frozen=True)
class Sensitivity:
    """How far the displacement moves, over the trials of the adult's gait, body lengths."""

    change: str
    duration: float
    trials: int
    median: float
    p95: float
    largest: float


def sensitivity(*, short: bool = False, threads: int | None = None) -> Iterator[Sensitivity]:
    """Change all masses by a millionth of a millionth, and the precision, at the shipped step."""
    case = long_gait(short)[0]
    exact = Physics(precision="float64", refinements=0)
    heavier = replace(case, morphology=Morphology(mass=1.0 + CHANGE))
    runs = {f"masses x (1 + {CHANGE:g})": (heavier, exact), "float32": (case, replace(exact, precision="float32"))}
    usual = _frames(case, exact, threads)
    for name, (changed, physics) in runs.items():
        other = _frames(changed, physics, threads)
        for horizon in SHORT_HORIZONS if short else HORIZONS:
            frame = round(horizon / case.frame)
            moved = [displacement(case.body, frames[[0, frame]]) for frames in (other, usual)]
            size = np.abs(moved[0] - moved[1])
            yield Sensitivity(
                name, horizon, len(size), float(np.median(size)), float(np.percentile(size, 95)), float(size.max())
            )


def _frames(case: Case, physics: Physics, threads: int | None) -> NDArray[np.float64]:
    positions = by_steps(case, physics, threads).positions
    assert positions is not None
    return positions.astype(np.float64)
