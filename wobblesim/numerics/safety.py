"""Which wobbles the shipped integrators stand, looked up in what `wobblesim stability` has measured.

The table holds one dimension at a time, for the robot, gait and scene named in it; nothing is computed here.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wobblesim.learning.wobble import Wobble
from wobblesim.robot.starfish import starfish

if TYPE_CHECKING:
    from wobblesim.learning.run import Setup
    from wobblesim.robot.body import Body

Range = tuple[float, float]

FILE = "safe_factors.json"
ADULT = "the adult"


@dataclass(frozen=True)
class Finding:
    """A range of factors that leaves what is known to be safe.

    Attributes
    ----------
    dimension : str
        That wobbles, or `ADULT`: the step is unsafe with no wobble at all.
    factors : (least, largest)
        That are used.
    integrator : str
    dt : float
        s.
    safe : (least, largest) or None
        Safe at this step; None: no factor is, or the step is beyond the table.
    safe_dt : float or None
        Largest step of the table, not above `dt`, at which the factors are safe, s.
    """

    dimension: str
    factors: Range
    integrator: str
    dt: float
    safe: Range | None
    safe_dt: float | None

    def __str__(self) -> str:
        at = f"{self.integrator} at dt {self.dt:g}"
        if self.dimension == ADULT:
            problem = f"{at} is not known to be stable for the adult robot"
        else:
            known = f"is only from {_between(self.safe)}" if self.safe else "is at no factor"
            problem = f"{self.dimension} goes from {_between(self.factors)}, and {at} is stable {known[3:]}"
        remedy = f"dt {self.safe_dt:g} would be" if self.safe_dt else "no step of the table would be"
        return f"{problem}; {remedy}"


def _between(factors: Range) -> str:
    return f"{factors[0]:.3g} to {factors[1]:.3g}"


@functools.cache
def table() -> dict[str, Any]:
    """The measured table: conditions, grid of factors, and safe ranges by integrator, step and dimension."""
    return json.loads(resources.files("wobblesim.numerics").joinpath(FILE).read_text(encoding="utf-8"))


def write(content: Mapping[str, Any], path: Path) -> None:
    """Write a table that `table` reads."""
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def factor_ranges(wobble: Wobble | None) -> dict[str, Range]:
    """Least and largest factor of each dimension that wobbles; the adult's 1 is always among them."""
    if wobble is None:
        return {}
    peak = wobble.mean + wobble.amplitude
    largest = max(1.0, peak if wobble.upper_bound is None else min(peak, wobble.upper_bound))
    return dict.fromkeys(wobble.dimensions, (wobble.least_factor(), largest))


def unsafe(
    integrator: str, dt: float, factors: Mapping[str, Range], known: Mapping[str, Any] | None = None
) -> list[Finding]:
    """What leaves the safe region; an empty list if nothing does.

    A step between two of the table's is judged by the next larger one.

    Parameters
    ----------
    integrator : str
        `explicit` refuses a step by itself: there is never a finding.
    dt : float
        s.
    factors : mapping of dimension to (least, largest)
        Factors in use: `factor_ranges`.
    known : mapping, optional
        Another table than the committed one.
    """
    steps = {float(step): ranges for step, ranges in (known or table())["safe"].get(integrator, {}).items()}
    if not steps:
        return []
    here = steps.get(min((step for step in steps if step >= dt * (1 - 1e-9)), default=np.nan), {})
    asked = dict(factors) or {ADULT: (1.0, 1.0)}
    return [
        Finding(dimension, needed, integrator, dt, _safe(here, dimension), _safe_step(steps, dt, dimension, needed))
        for dimension, needed in asked.items()
        if not _holds(_safe(here, dimension), needed)
    ]


def _safe(ranges: Mapping[str, Any], dimension: str) -> Range | None:
    """Safe factors of a dimension; the adult's if any dimension has some."""
    found = ranges.get(dimension) if dimension != ADULT else next(filter(None, ranges.values()), None)
    return (float(found[0]), float(found[1])) if found else None


def _holds(safe: Range | None, needed: Range) -> bool:
    margin = 1e-9  # 1 - 0.9 is not 0.1
    return safe is not None and safe[0] <= needed[0] * (1 + margin) and needed[1] <= safe[1] * (1 + margin)


def _safe_step(steps: Mapping[float, Any], dt: float, dimension: str, needed: Range) -> float | None:
    good = [step for step, ranges in steps.items() if step <= dt and _holds(_safe(ranges, dimension), needed)]
    return max(good, default=None)


def remarks(setup: Setup, known: Mapping[str, Any] | None = None) -> list[str]:
    """What a setup leaves the safe region with, a sentence each, ready to be shown before a sweep."""
    findings = unsafe(setup.physics.integrator, setup.physics.dt, factor_ranges(setup.wobble), known)
    if not findings:
        return []
    other = differences(setup, known)
    caveat = f" (measured with another {' and '.join(other)})" if other else ""
    return [f"{finding}{caveat}" for finding in findings]


def differences(setup: Setup, known: Mapping[str, Any] | None = None) -> list[str]:
    """What of a setup is not as it was when the table was measured; then the table is a hint and no more."""
    conditions = (known or table())["conditions"]
    physics, scene, floor = setup.physics, setup.scene, setup.scene.floor
    matters = {"midpoint": "theta", "impulse": "iterations"}.get(physics.integrator)
    same = {
        "robot": _is_adult_starfish(setup.body),
        "gait": (setup.gait.period, setup.gait.max_amplitude) == tuple(conditions["gait"]),
        "gravity": list(scene.gravity_vector) == conditions["gravity"],
        "floor": floor is not None and vars(floor) == conditions["floor"],
        "precision": physics.precision == conditions["precision"],
    }
    if matters:
        same[matters] = getattr(physics, matters) == conditions[matters]
    return [name for name, is_same in same.items() if not is_same]


@functools.lru_cache(maxsize=64)  # the conditions of a study share their robot
def _is_adult_starfish(body: Body) -> bool:
    adult = starfish()
    arrays = [name for name, value in vars(adult).items() if isinstance(value, np.ndarray)]
    return all(np.array_equal(getattr(body, name), getattr(adult, name)) for name in arrays)
