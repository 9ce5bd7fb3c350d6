"""The linearly implicit midpoint rule (design, section 4, ``midpoint``): full matrix, dense solve."""

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


def simulate_one(body, behaviour, *, gravity, floor, gait, dt, steps, theta=0.6) -> Trajectory:
    """Steps of `dt` s from the body's start; `gravity` is a vector (2,) in u/s2."""
    x, v = np.array(body.position, dtype=float), np.array(body.velocity, dtype=float)
    v[body.fixed] = 0
    anchor, dashpots = np.full(len(x), np.nan), damping(body)
    free = np.repeat(~np.asarray(body.fixed), 2)
    trajectory = Trajectory()
    trajectory.keep(x, v)
    for n in range(steps):
        middle = x + dt / 2 * v
        rest = rest_lengths(body, behaviour, gait, n * dt + dt / 2)
        matrix = np.diag(np.repeat(np.asarray(body.mass, dtype=float), 2))
        impulse = dt * np.asarray(body.mass)[:, None] * np.asarray(gravity)
        add_springs(body, dashpots, middle, v, rest, dt, theta, matrix, impulse)
        if floor is not None:
            add_floor(body, middle, v, anchor, floor, dt, matrix, impulse)
        change = np.zeros(2 * len(x))
        change[free] = np.linalg.solve(matrix[np.ix_(free, free)], impulse.ravel()[free])
        change = change.reshape(-1, 2)
        x += dt * (v + change / 2)
        v += change
        trajectory.keep(x, v)
    return trajectory


def add_springs(body, dashpots, middle, v, rest, h, theta, matrix, impulse) -> None:
    """Impulse h f and axial matrix block s u u^T of each spring, at the midpoint prediction."""
    for s in movable(body):
        a, b = body.springs[s]
        k, c = body.stiffness[s], dashpots[s]
        unit, distance = direction(middle[a], middle[b])
        force = k * (distance - rest[s]) + c * unit @ (v[b] - v[a])
        impulse[a] += h * force * unit
        impulse[b] -= h * force * unit
        rows = np.array([2 * a, 2 * a + 1, 2 * b, 2 * b + 1])
        stretch = np.concatenate([-unit, unit])  # what the four coordinates do to the spring's length
        matrix[rows[:, None], rows] += (h * c / 2 + theta * h * h / 2 * k) * np.outer(stretch, stretch)


def add_floor(body, middle, v, anchor, floor, h, matrix, impulse) -> None:
    """Impulse of the floor on each pressing node and what it changes on the diagonal; moves the anchors.

    A node crosses the floor's surface within the step, at the speed it has. The force is its mean over the time that
    it presses; dashpots are bounded, so that what a step takes from the velocity stays in proportion to it.
    """
    for node in np.flatnonzero(~np.asarray(body.fixed)):
        m, mu, k = body.mass[node], body.friction[node], contact_stiffness(body, node, floor)
        c_n = min(2 * contact_damping_ratio(floor.restitution) * np.sqrt(k * m), 2 * m / h)
        begin, end = pressing_time(middle[node, 1], v[node, 1], c_n / k, h)
        if begin == end:
            anchor[node] = np.nan  # in the air
            continue
        time, centre = end - begin, (begin + end) / 2 - h / 2  # from the middle of the step
        x, y = middle[node] + centre * v[node]
        normal = -k * y - c_n * v[node, 1]
        if np.isnan(anchor[node]):
            anchor[node] = middle[node, 0] + (begin - h / 2) * v[node, 0]  # where the node first presses
        impulse[node, 1] += time * normal
        matrix[2 * node + 1, 2 * node + 1] += time / 2 * (c_n + h / 2 * k)
        # What the node's own change of velocity, if no other node moved, takes off the forces of this step.
        own, inertia = impulse[node], np.diag(matrix)[2 * node : 2 * node + 2]
        limit = mu * (normal - (c_n / 2 + h / 4 * k) * own[1] / inertia[1])
        if limit <= 0:
            anchor[node] = np.nan
            continue
        c_t = min(2 * TANGENTIAL_DAMPING_RATIO * np.sqrt(k * m), m / h)
        tangent, taken = k * (anchor[node] - x) - c_t * v[node, 0], c_t / 2 + h / 4 * k
        left = tangent - taken * (own[0] + time * tangent) / (inertia[0] + time * taken)
        if abs(left) <= limit:
            impulse[node, 0] += time * tangent
            matrix[2 * node, 2 * node] += time * taken
        else:
            tangent = np.copysign(limit, left)
            impulse[node, 0] += time * tangent
            anchor[node] = x + (tangent + c_t * v[node, 0]) / k


def pressing_time(middle, speed, relaxation, h) -> tuple[float, float]:
    """When in a step [0, h] a node at height ``middle + speed (t - h/2)`` feels a push, k p - c p' > 0 and p > 0."""
    surface = min(0.0, -relaxation * speed)
    if speed == 0:
        return (0.0, h) if middle < surface else (0.0, 0.0)
    crossing = min(max(h / 2 + (surface - middle) / speed, 0.0), h)
    return (crossing, h) if speed < 0 else (0.0, crossing)
