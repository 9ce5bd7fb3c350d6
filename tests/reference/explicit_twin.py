"""The classical Runge-Kutta method (design, section 4, ``explicit``): forces summed spring by spring."""

from __future__ import annotations

import numpy as np
from reference.law import (
    TANGENTIAL_DAMPING_RATIO,
    Trajectory,
    contact_damping_ratio,
    contact_stiffness,
    damping,
    direction,
    movable,
    rest_lengths,
)


def simulate_one(body, behaviour, *, gravity, floor, gait, dt, steps) -> Trajectory:
    """Steps of `dt` s from the body's start; `gravity` is a vector (2,) in u/s2."""
    x, v = np.array(body.position, dtype=float), np.array(body.velocity, dtype=float)
    v[body.fixed] = 0
    anchor, dashpots = x[:, 0].copy(), damping(body)
    trajectory = Trajectory()
    trajectory.keep(x, v)

    def slope(time, x, v):
        rest = rest_lengths(body, behaviour, gait, time)
        return v, acceleration(body, dashpots, x, v, rest, gravity, floor, anchor)

    for n in range(steps):
        t = n * dt
        x1, v1 = slope(t, x, v)
        x2, v2 = slope(t + dt / 2, x + dt / 2 * x1, v + dt / 2 * v1)
        x3, v3 = slope(t + dt / 2, x + dt / 2 * x2, v + dt / 2 * v2)
        x4, v4 = slope(t + dt, x + dt * x3, v + dt * v3)
        x = x + dt / 6 * (x1 + 2 * x2 + 2 * x3 + x4)
        v = v + dt / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
        if floor is not None:
            move_anchors(body, x, v, anchor, floor)
        trajectory.keep(x, v)
    return trajectory


def acceleration(body, dashpots, x, v, rest, gravity, floor, anchor) -> np.ndarray:
    """Accelerations (nodes, 2) in u/s2; fixed nodes have none."""
    force = np.asarray(body.mass)[:, None] * np.asarray(gravity, dtype=float)
    for s in movable(body):
        a, b = body.springs[s]
        unit, distance = direction(x[a], x[b])
        pull = body.stiffness[s] * (distance - rest[s]) + dashpots[s] * unit @ (v[b] - v[a])
        force[a] += pull * unit
        force[b] -= pull * unit
    if floor is not None:
        for node in range(len(x)):
            normal, tangent, _ = floor_force(body, node, x[node], v[node], anchor[node], floor)
            force[node] += tangent, normal
    force[body.fixed] = 0
    return force / np.asarray(body.mass)[:, None]


def floor_force(body, node, x, v, anchor, floor) -> tuple[float, float, float]:
    """Normal and tangential force on a node, and where that leaves its anchor."""
    m, mu, k = body.mass[node], body.friction[node], contact_stiffness(body, node, floor)
    depth = -x[1]
    c_n = 2 * contact_damping_ratio(floor.restitution) * np.sqrt(k * m)
    normal = max(0.0, k * depth - c_n * v[1]) if depth > 0 else 0.0
    if normal == 0:
        return 0.0, 0.0, x[0]
    if mu == 0:
        return normal, 0.0, anchor
    c_t = 2 * TANGENTIAL_DAMPING_RATIO * np.sqrt(k * m)
    tangent = k * (anchor - x[0]) - c_t * v[0]
    if abs(tangent) <= mu * normal:
        return normal, tangent, anchor
    tangent = np.copysign(mu * normal, tangent)
    return normal, tangent, x[0] + (tangent + c_t * v[0]) / k


def move_anchors(body, x, v, anchor, floor) -> None:
    """Drag the anchors of slipping nodes, and let those of nodes in the air follow them."""
    for node in range(len(x)):
        anchor[node] = floor_force(body, node, x[node], v[node], anchor[node], floor)[2]
