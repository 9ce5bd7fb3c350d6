"""The author's engine law (design, section 4, ``impulse``): one robot, one spring after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from reference.law import Trajectory, damping, direction, inverse_masses, movable, rest_lengths

LONGEST_MOVE = 2.0  # u in one step


@dataclass
class Link:
    """A spring as a soft constraint during one step."""

    spring: int
    a: int
    b: int
    unit: np.ndarray
    mass: float
    gamma: float
    beta: float


@dataclass
class Touch:
    """A node on the floor during one step: rebound speed and accumulated impulses per mass."""

    node: int
    rebound: float
    normal: float = 0.0
    tangent: float = 0.0


def simulate_one(body, behaviour, *, gravity, floor, gait, dt, steps, iterations=5) -> Trajectory:
    """Steps of `dt` s from the body's start; `gravity` is a vector (2,) in u/s2."""
    x, v = np.array(body.position, dtype=float), np.array(body.velocity, dtype=float)
    v[body.fixed] = 0
    impulses = np.zeros(len(body.springs))
    trajectory = Trajectory()
    trajectory.keep(x, v)
    for n in range(steps):
        v[~body.fixed] += dt * np.asarray(gravity)
        rest = rest_lengths(body, behaviour, gait, n * dt)
        links = make_links(body, x, rest, dt)
        for link in links:
            push(body, v, link, impulses[link.spring])
        touches = [] if floor is None else make_touches(body, x, v, floor)
        for _ in range(iterations):
            for touch in touches:
                solve_touch(body.friction[touch.node], v, touch)
            for link in links:
                solve_link(body, v, link, impulses)
        trajectory.limited += move(x, v, dt)
        trajectory.keep(x, v)
    return trajectory


def make_links(body, x, rest, h) -> list[Link]:
    """Unit vector, effective mass, softness and bias of each spring at positions `x`, in creation order."""
    links, inverse, dashpots = [], inverse_masses(body), damping(body)
    for s in movable(body):
        a, b = body.springs[s]
        k, c = body.stiffness[s], dashpots[s]
        unit, distance = direction(x[a], x[b])
        gamma = 1 / (h * (c + h * k))
        beta = (distance - rest[s]) * h * k * gamma
        links.append(Link(s, a, b, unit, 1 / (inverse[a] + inverse[b] + gamma), gamma, beta))
    return links


def push(body, v, link, impulse) -> None:
    """Apply an impulse along the spring to its two nodes."""
    inverse = inverse_masses(body)
    v[link.a] -= impulse * link.unit * inverse[link.a]
    v[link.b] += impulse * link.unit * inverse[link.b]


def solve_link(body, v, link, impulses) -> None:
    """One Gauss-Seidel visit of a spring."""
    speed = link.unit @ (v[link.b] - v[link.a])
    change = -link.mass * (speed + link.beta + link.gamma * impulses[link.spring])
    impulses[link.spring] += change
    push(body, v, link, change)


def make_touches(body, x, v, floor) -> list[Touch]:
    """Put the nodes under the floor on it; those that do not move up touch it."""
    touches = []
    for node in range(len(x)):
        if body.fixed[node] or x[node, 1] > 0:
            continue
        x[node, 1] = 0
        speed = v[node, 1]
        if speed <= 0:
            slow = speed > -floor.restitution_threshold
            touches.append(Touch(node, 0.0 if slow else -floor.restitution * speed))
    return touches


def solve_touch(mu, v, touch) -> None:
    """One Gauss-Seidel visit of a contact: friction within the last normal impulse, then the normal."""
    v_x, v_y = v[touch.node]
    limit = mu * abs(touch.normal)
    if abs(v_x) > 1:
        limit /= 2
    tangent = min(max(touch.tangent - v_x, -limit), limit)
    v[touch.node, 0] += tangent - touch.tangent
    touch.tangent = tangent
    normal = touch.normal + touch.rebound - v_y
    v[touch.node, 1] += normal - touch.normal
    touch.normal = normal


def move(x, v, h) -> int:
    """Advance the positions; cut moves (and their velocities) longer than 2 u. Returns how many were cut."""
    cut = 0
    for node in range(len(x)):
        length = h * np.sqrt(v[node] @ v[node])
        if length > LONGEST_MOVE:
            v[node] *= LONGEST_MOVE / length
            cut += 1
        x[node] += h * v[node]
    return cut
