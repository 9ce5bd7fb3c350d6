"""The energy of a robot whose motors are off: it may only fall.

What rises is energy that the method made: a little at a touch-down that falls badly into the step (docs/limits.md),
more and more where it is unstable. Only the latter carries the sum above that of the start, a drop from `HEIGHT`.
The energy of the anchors that hold nodes on the floor cannot be seen from outside and is left out; so the sum is never
too large.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Floor, Physics, Scene
from wobblesim.physics.simulate import simulate
from wobblesim.robot.body import Body
from wobblesim.robot.morphology import Morphology

Floats = NDArray[np.float64]

HEIGHT = 100.0  # u, of the lowest node above the floor
TILT = 0.3  # rad, so that the arms land one after the other


def velocities(integrator: str, x: Floats, start: Floats, dt: float) -> Floats:
    """Velocities that a method holds beside positions recorded at every step; exact but for rounding.

    `impulse` moves by ``x' = x + h v'``, `midpoint` by ``x' = x + h (v + v')/2``.

    Parameters
    ----------
    x : (steps + 1, n_nodes, 2)
        u.
    start : (n_nodes, 2)
        u/s.

    Raises
    ------
    ValueError
        If the integrator's velocities do not follow from its positions.
    """
    move = np.diff(x, axis=0) / dt
    if integrator == "impulse":
        return np.concatenate([start[None], move])
    if integrator != "midpoint":
        raise ValueError(f"the velocities of {integrator!r} do not follow from its positions")
    # v_n = 2 move_n - v_(n-1), written as a sum of alternating signs
    sign = np.where(np.arange(len(x)) % 2, -1.0, 1.0)[:, None, None]
    return sign * np.cumsum(np.concatenate([start[None], 2.0 * sign[1:] * move]), axis=0)


def energy(body: Body, x: Floats, v: Floats, gravity: tuple[float, float], floor: Floor | None) -> Floats:
    """Energy ``(frames,)`` of motion, springs at their rest lengths, weight and a compliant floor's penetration."""
    a, b = body.springs.T
    stretch = np.linalg.norm(x[:, b] - x[:, a], axis=-1) - body.rest_length
    motion = 0.5 * np.sum(body.mass * np.sum(v**2, axis=-1), axis=-1)
    weight = -np.sum(body.mass * (x @ np.asarray(gravity)), axis=-1)
    pressed = 0.5 * floor.stiffness * np.sum(body.mass * np.minimum(x[:, :, 1], 0.0) ** 2, axis=-1) if floor else 0.0
    return motion + 0.5 * np.sum(body.stiffness * stretch**2, axis=-1) + weight + pressed


def above_start(energies: Floats) -> float:
    """Most energy above the start's, as a part of it (0 if it never is); infinite if one is not finite."""
    return _part(energies, energies - energies[0])


def largest_rise(energies: Floats) -> float:
    """Largest rise between two moments, as a part of the energy at the start; infinite if one is not finite."""
    return _part(energies, energies - np.minimum.accumulate(energies))


def _part(energies: Floats, excess: Floats) -> float:
    return float(excess.max() / abs(energies[0])) if np.isfinite(energies).all() else math.inf


def dropped(body: Body) -> Body:
    """The body tilted by `TILT`, its lowest node `HEIGHT` above the floor."""
    turn = np.array([[math.cos(TILT), math.sin(TILT)], [-math.sin(TILT), math.cos(TILT)]])
    position = body.position @ turn
    position[:, 1] += HEIGHT - position[:, 1].min()
    return replace(body, position=position, velocity=np.zeros_like(position), build=None)


def energy_of_a_drop(body: Body, morphology: Morphology, physics: Physics, seconds: float) -> Floats:
    """Drop a robot, motors off, and return its energy ``(steps + 1,)``."""
    adapted = dropped(body.adapted(morphology))
    adult = Scene()
    gx, gy = adult.gravity_vector
    scene = replace(adult, gravity=(morphology.gravity * gx, morphology.gravity * gy))
    motors_off: Any = np.zeros((1, 2 * body.n_groups))
    trials = simulate(adapted, motors_off, scene=scene, physics=physics, duration=seconds, record_every=1)
    assert trials.positions is not None
    x = trials.positions[..., 0].astype(np.float64)
    v = velocities(physics.integrator, x, adapted.velocity, physics.dt)
    floor = scene.floor if INTEGRATORS[physics.integrator].contact == "compliant" else None
    return energy(adapted, x, v, scene.gravity_vector, floor)
