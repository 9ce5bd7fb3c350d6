"""What the twins share, straight from the equations: motor signals, damping, directions, the floor's dashpot.

A twin simulates one robot at a time in float64, spring by spring. It takes any object with the fields of ``Body``
(already adapted to its morphology), a ``gait`` with ``period`` and ``max_amplitude``, and a ``floor`` with
``restitution``, ``restitution_threshold`` and ``stiffness``, or None for free flight.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.optimize import brentq

TANGENTIAL_DAMPING_RATIO = 0.2  # of the sticking spring


@dataclass
class Trajectory:
    """One robot's states; frame 0 is the start, then one frame a step.

    positions: (steps + 1, nodes, 2) in u. velocities: (steps + 1, nodes, 2) in u/s.
    limited: number of moves that the speed cap cut.
    """

    positions: list[np.ndarray] = field(default_factory=list)
    velocities: list[np.ndarray] = field(default_factory=list)
    limited: int = 0

    def keep(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Append copies of one state."""
        self.positions.append(position.copy())
        self.velocities.append(velocity.copy())


def rest_lengths(body, behaviour: np.ndarray, gait, time: float) -> np.ndarray:
    """Rest lengths (springs,) in u at `time` in s: muscles scaled by 1 + sign * alpha, the others as built."""
    groups = len(behaviour) // 2
    amplitudes, offsets = behaviour[:groups], behaviour[groups:]
    alpha = gait.max_amplitude * amplitudes * np.sin(2 * np.pi * (time / gait.period + offsets))
    lengths = np.array(body.rest_length, dtype=float)
    for spring, group, sign in zip(body.muscle_spring, body.muscle_group, body.muscle_sign, strict=True):
        lengths[spring] *= 1 + sign * alpha[group]
    return lengths


def inverse_masses(body) -> np.ndarray:
    """1/m of each node (nodes,), 0 for a fixed one."""
    return np.where(body.fixed, 0.0, 1.0 / np.asarray(body.mass))


def movable(body) -> list[int]:
    """Springs that can do something: those with at least one free end."""
    return [s for s, (a, b) in enumerate(body.springs) if not (body.fixed[a] and body.fixed[b])]


def damping(body) -> np.ndarray:
    """Dashpots c = 2 zeta sqrt(k m_r) of the springs (springs,), 0 between two fixed nodes."""
    inverse = inverse_masses(body)
    dashpots = np.zeros(len(body.springs))
    for s in movable(body):
        a, b = body.springs[s]
        reduced_mass = 1 / (inverse[a] + inverse[b])
        dashpots[s] = 2 * body.damping_ratio[s] * np.sqrt(body.stiffness[s] * reduced_mass)
    return dashpots


def direction(from_: np.ndarray, to: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit vector and distance between two points; coincident points have no direction: (0, 0)."""
    difference = to - from_
    distance = float(np.sqrt(difference[0] ** 2 + difference[1] ** 2))
    return (difference / distance if distance > 0 else np.zeros(2)), distance


def contact_stiffness(body, node, floor):
    """Stiffness k = m * Floor.stiffness of the contact of a node (or of several)."""
    return floor.stiffness * np.asarray(body.mass)[node]


def rebound(damping_ratio: float) -> float:
    """Restitution of a tensionless linear spring-dashpot contact without gravity.

    ``p'' = -p - 2 z p'``, ``p(0) = 0``, ``p'(0) = 1``: the contact ends when the force ``p + 2 z p'`` falls to zero.
    For z = sin(a) that is at phase ``w t = pi - 2 a = 2 acos(z)``, where p = -2 z p' leaves ``|p'| = exp(-z t)``.
    """
    z = damping_ratio
    if z == 1:
        return float(np.exp(-2))
    if z < 1:
        return float(np.exp(-2 * z * np.arccos(z) / np.sqrt(1 - z * z)))
    return float(np.exp(-2 * z * np.arccosh(z) / np.sqrt(z * z - 1)))


@cache
def contact_damping_ratio(restitution: float) -> float:
    """Inverse of `rebound` within [0, 50]; 50 where even that rebounds more (restitution below 1e-4)."""
    if restitution <= rebound(50.0):
        return 50.0
    return float(brentq(lambda z: rebound(z) - restitution, 0.0, 50.0, xtol=1e-14))
