"""Where the robot moves, and how its motion is computed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any


def _require(good: bool, name: str, value: Any, allowed: str) -> None:
    if not good:
        raise ValueError(f"{name} is {value!r}: it must be {allowed}")


@dataclass(frozen=True)
class Floor:
    """The floor y = 0; only nodes touch it.

    Parameters
    ----------
    restitution : float
        Rebound speed over impact speed, 0 to 1. A compliant contact reaches it in the limit of small steps only
        (docs/limits.md).
    restitution_threshold : float
        Impacts slower than this do not rebound, u/s. Used by the rigid contact of `impulse` only: a compliant
        contact damps small bounces by itself.
    stiffness : float
        Of the compliant contact of `midpoint` and `explicit`, normal and tangential, per unit of the node's mass,
        1/s². A node at rest sinks g/stiffness. The default goes with the default step: a stiffer floor is nearer to a
        rigid one, but its impacts are resolved less well, and at dt 0.02 the sum of both errors is least between
        10,000 and 20,000 (docs/design-changes.md).
    """

    restitution: float = 0.5
    restitution_threshold: float = 1.0
    stiffness: float = 10_000.0

    def __post_init__(self) -> None:
        _require(0 <= self.restitution <= 1, "restitution", self.restitution, "in [0, 1]")
        _require(0 <= self.restitution_threshold < math.inf, "restitution_threshold", self.restitution_threshold,
                 "finite and >= 0 u/s")  # fmt: skip
        _require(0 < self.stiffness < math.inf, "the floor's stiffness", self.stiffness, "finite and > 0")


@dataclass(frozen=True)
class Scene:
    """Gravity and floor.

    Parameters
    ----------
    gravity : float or (gx, gy)
        u/s²; a number points down. A pair inclines the scene: ``(g sin a, -g cos a)`` is a slope of angle a.
    floor : Floor or None
        None: free flight.
    """

    gravity: float | tuple[float, float] = 100.0
    floor: Floor | None = field(default_factory=Floor)

    def __post_init__(self) -> None:
        if isinstance(self.gravity, list):
            object.__setattr__(self, "gravity", tuple(self.gravity))  # what is prepared for a scene is kept by its hash
        _require(all(map(math.isfinite, self.gravity_vector)), "gravity", self.gravity, "finite")

    @property
    def gravity_vector(self) -> tuple[float, float]:
        """Gravity along x and y, u/s²."""
        if isinstance(self.gravity, tuple):
            gx, gy = self.gravity
            return float(gx), float(gy)
        return 0.0, -float(self.gravity)


@dataclass(frozen=True)
class Physics:
    """How motion is computed.

    Parameters
    ----------
    integrator : str
        A name of `INTEGRATORS`: ``midpoint``, ``impulse`` or ``explicit``.
    dt : float
        Step, s. The default is the largest at which the gait's displacement after 5 s is off by less than 1 % of a body
        length (docs/accuracy.md).
    precision : str
        ``float32`` or ``float64``.
    iterations : int
        Of `impulse`.
    theta : float
        Of `midpoint`: weight of the new position in the springs' forces, 0.5 to 1. At 0.5 the stiffest springs ring
        (counts in docs/stability.md). A larger theta costs accuracy in free flight (docs/design-changes.md).
    max_speed : float or None
        Bound on the speed of every node, u/s; this and the two below are the trusted bounds, beyond which a motion is
        taken for a failure of the integrator. None is no bound. The default is 6 times the fastest node seen in 8192
        random trials, of robots down to a fifth of the mass; free fall at gravity 100 comes to it after 500 s.
    max_strain : float or None
        Bound on the change of length of every spring over its rest length. The default is 8 times the largest
        seen, 2.4: a crushed arm that snaps back.
    max_energy : float or None
        Bound on the energy gained since the start (kinetic, elastic, and in the field of gravity), over the energy that
        the body's weight and muscles deal with (`bounds.energy_scale`). Only muscles can add energy; the default is 10
        times the most seen, 2.0. What blows up passes 1e6 (docs/physics.md, "Trusted bounds").
    refinements : int
        How often a trial that leaves the bounds is repeated with half the step before it counts as diverged.
    """

    integrator: str = "midpoint"
    dt: float = 0.02
    precision: str = "float32"
    iterations: int = 5
    theta: float = 0.6
    max_speed: float | None = 5e4
    max_strain: float | None = 20.0
    max_energy: float | None = 20.0
    refinements: int = 3

    def __post_init__(self) -> None:
        _require(0 < self.dt < math.inf, "dt", self.dt, "finite and > 0 s")
        _require(self.precision in ("float32", "float64"), "precision", self.precision, "float32 or float64")
        whole = isinstance(self.iterations, int) and self.iterations >= 1
        _require(whole, "iterations", self.iterations, "a whole number from 1")
        _require(0.5 <= self.theta <= 1, "theta", self.theta, "in [0.5, 1]")
        _require(isinstance(self.refinements, int) and self.refinements >= 0, "refinements", self.refinements,
                 "a whole number from 0")  # fmt: skip
        for name in ("max_speed", "max_strain", "max_energy"):
            bound = getattr(self, name)
            _require(bound is None or bound > 0, name, bound, "> 0, or None for no bound")
