"""Named bodies and behaviours that the tests share. Units: u, s, the author's mass unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import wobblesim as ws

LENGTH = 10.0  # u, rest length of the springs below


def oscillators(omega: float, damping_ratios: Sequence[float], stretch: float = 1.0, mass: float = 1.0) -> ws.Body:
    """Horizontal springs side by side, each from a fixed node to a free one, released at rest from `stretch`."""
    n = len(damping_ratios)
    position = np.zeros((2 * n, 2))
    position[:, 1] = np.repeat(20.0 * np.arange(n), 2)
    position[1::2, 0] = LENGTH + stretch
    return ws.Body.from_arrays(
        position,
        [(2 * i, 2 * i + 1) for i in range(n)],
        mass=mass,
        fixed=[True, False] * n,
        stiffness=mass * omega**2,
        damping_ratio=damping_ratios,
        rest_length=LENGTH,
    )


def hanging_masses(masses: Sequence[float], stiffnesses: Sequence[float]) -> ws.Body:
    """Critically damped springs side by side, each from a fixed node to a mass below it, unstretched."""
    n = len(masses)
    position = np.zeros((2 * n, 2))
    position[:, 0] = np.repeat(20.0 * np.arange(n), 2)
    position[1::2, 1] = -LENGTH
    return ws.Body.from_arrays(
        position,
        [(2 * i, 2 * i + 1) for i in range(n)],
        mass=np.repeat(masses, 2),
        fixed=[True, False] * n,
        stiffness=stiffnesses,
    )


def chain(nodes: int = 5, end_mass: float = 1.0, stiffness: float = 1000.0, damping_ratio: float = 1.0) -> ws.Body:
    """Vertical chain below a fixed node, a node of `end_mass` at its end; every spring is a muscle of one group."""
    masses = np.ones(nodes + 1)
    masses[-1] = end_mass
    position = np.stack([np.zeros(nodes + 1), -LENGTH * np.arange(nodes + 1)], axis=1)
    return ws.Body.from_arrays(
        position,
        [(i, i + 1) for i in range(nodes)],
        mass=masses,
        fixed=np.arange(nodes + 1) == 0,
        stiffness=stiffness,
        damping_ratio=damping_ratio,
        muscles=[(i, 0, 1.0) for i in range(nodes)],
        body_length=LENGTH,
    )


def triangle() -> ws.Body:
    """Three nodes, three springs, two of them muscles of one group each: the smallest robot that walks."""
    return ws.Body.from_arrays(
        [(0, 0), (30, 0), (15, 25)],
        [(0, 1), (1, 2), (2, 0)],
        stiffness=[3000.0, 12000.0, 3000.0],
        muscles=[(0, 0, 1.0), (2, 1, -1.0)],
    )


def grains(velocities: np.ndarray, height: float = 0.0, friction: float = 0.5, mass: float = 1.0) -> ws.Body:
    """Loose nodes at one height, far apart, without any spring."""
    n = len(velocities)
    position = np.stack([100.0 * np.arange(n), np.full(n, height)], axis=1)
    return ws.Body.from_arrays(position, velocity=velocities, friction=friction, mass=mass)


def small_starfish() -> ws.Body:
    """Three arms of two sections."""
    return ws.starfish(arms=3, sections=2)


def random_body(
    seed: int, *, nodes: int = 8, springs: int = 14, muscles: int = 6, fixed: int = 1, coincident: bool = False
) -> ws.Body:
    """A random graph of unlike nodes and springs on and above the floor, moving; two motor groups."""
    rng = np.random.default_rng(seed)
    position = rng.uniform((0, 0), (60, 40), (nodes, 2))
    position[::3, 1] /= 40  # a third of the nodes is about to land
    if coincident:
        position[1] = position[0]
    pairs = [(i, j) if rng.random() < 0.5 else (j, i) for i in range(nodes) for j in range(i)]
    first = [pairs.index(p) for p in ((0, 1), (1, 0)) if p in pairs]  # nodes 0 and 1 are always joined
    others = [i for i in rng.permutation(len(pairs)) if i not in first]
    chosen = [pairs[i] for i in [*first, *others][:springs]]
    built = np.array([np.hypot(*(position[b] - position[a])) for a, b in chosen])
    velocity = rng.normal(0, 20, (nodes, 2))
    if coincident:
        velocity[1] = velocity[0]
    return ws.Body.from_arrays(
        position,
        chosen,
        mass=rng.uniform(0.5, 3, nodes),
        friction=rng.uniform(0, 1, nodes),
        fixed=np.isin(np.arange(nodes), rng.permutation(nodes)[:fixed]),
        velocity=velocity,
        stiffness=10 ** rng.uniform(2.5, 3.7, springs),
        damping_ratio=rng.uniform(0, 2, springs),
        rest_length=built * rng.uniform(0.9, 1.1, springs),
        muscles=[(s, i % 2, float(rng.choice([-1, 1]))) for i, s in enumerate(rng.permutation(springs)[:muscles])],
    )


def random_behaviours(seed: int, trials: int, groups: int) -> np.ndarray:
    """Uniform amplitudes and offsets (trials, 2 groups)."""
    return np.random.default_rng(seed).random((trials, 2 * groups))


def still(body: ws.Body, trials: int = 1) -> np.ndarray:
    """Behaviours of amplitude 0."""
    return np.zeros((trials, 2 * body.n_groups))
