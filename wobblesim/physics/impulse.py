"""`impulse`: sequential impulses with warm start, the law of the engine behind the paper's results.

Springs are soft constraints on velocity (Catto 2011, "Soft Constraints"), solved one after the other a fixed number
of times; contacts are rigid. Its known faults are kept, for comparison: it is of order 1 and not converged at
dt 0.005, its iterations converge to the wrong answer, friction is half of Coulomb's above 1 u/s, contacts may pull,
and moves are cut to 2 u a step, which hides instability (counted here as `limited`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wobblesim.physics.contract import (
    CLOSEST,
    Array,
    Dtype,
    Integrator,
    Method,
    State,
    System,
    caster,
    plan_array,
    rows,
    set_rest_lengths,
    step_of,
)
from wobblesim.physics.kernels import inlined, kernel
from wobblesim.physics.lanes import LanesTag, any_lane, larger, load, select, smaller, splat, square_root, store
from wobblesim.physics.ordering import schedule_springs
from wobblesim.physics.scene import Physics

LONGEST_MOVE = 2.0  # u a step, of the author's engine
HALF_FRICTION_SPEED = 1.0  # u/s: above it, friction's limit is halved


class Impulse(NamedTuple):
    """Constants; springs in scheduled order (the same bits as creation order)."""

    h: Any
    iterations: int
    gravity: Array | None  # (2,): u/s a step
    restitution: Any  # of the floor, None for 0
    inverse_mass: Array  # (n_nodes,)
    a: Array  # (n_springs,) int
    b: Array
    rest_row: Array  # (n_springs,) int
    gain: Array  # (n_springs,): h k gamma, from stretch to beta
    gamma: Array  # (n_springs,): 1/(h (c + h k))
    mass: Array  # (n_springs,): M = 1/(1/m_a + 1/m_b + gamma)
    top_speed: Any  # u/s: the longest move in one step
    half_friction_speed: Any  # u/s


class RigidFloor(NamedTuple):
    """Constants of the rigid contact."""

    threshold: Any  # u/s


class Work(NamedTuple):
    """Rows of one block of lanes."""

    ux: Array  # (n_springs, width): unit vector from a to b
    uy: Array
    beta: Array  # (n_springs, width): velocity that undoes the stretch
    impulse: Array  # (n_springs, width): P, kept between steps
    q_n: Array  # (n_nodes, width): accumulated normal impulse over mass
    q_t: Array
    rebound: Array  # (n_nodes, width): b, or NaN where the contact is not active
    touching: Array  # (n_nodes,) int: nodes with a contact in some lane


def prepare(system: System, physics: Physics, dtype: Dtype) -> Method:
    """Fill the constants of one system."""
    h, n = physics.dt, system.n_nodes
    order = schedule_springs(system.springs, n)
    a, b = system.springs[order].T
    k = system.k[order]
    c = 0.0 if system.c is None else system.c[order]
    gamma = 1.0 / (h * (c + h * k))
    floor = system.floor
    bounces = floor and (floor.restitution > 0 or not system.leave_out)

    cast = caster(dtype)
    constants = Impulse(
        h=dtype.type(h), iterations=physics.iterations, gravity=cast(system.gravity and h * np.array(system.gravity)),
        restitution=dtype.type(floor.restitution) if floor and bounces else None,
        inverse_mass=cast(system.inverse_mass), a=plan_array(a), b=plan_array(b),
        rest_row=plan_array(system.rest_row[order]), gain=cast(h * k * gamma), gamma=cast(gamma),
        mass=cast(1.0 / (system.inverse_mass[a] + system.inverse_mass[b] + gamma)),
        top_speed=dtype.type(LONGEST_MOVE / h), half_friction_speed=dtype.type(HALF_FRICTION_SPEED),
    )  # fmt: skip

    def workspace(tag: LanesTag, state: State) -> Work:
        m = len(a)
        return Work(
            ux=rows(m, tag), uy=rows(m, tag), beta=rows(m, tag), impulse=rows(m, tag),
            q_n=rows(n, tag), q_t=rows(n, tag), rebound=rows(n, tag), touching=np.zeros(n, np.uint32),
        )  # fmt: skip

    rigid = floor and RigidFloor(dtype.type(floor.restitution_threshold))
    return Method(constants, rigid, cast(system.friction), np.arange(n), 0.0, workspace)


INTEGRATOR = Integrator("impulse", 1, "rigid", True, 2, prepare)


@step_of(Impulse)
def _step(tag, constants, floor, friction, muscles, state, rest, limited, work, n):
    set_rest_lengths(tag, muscles, rest, 2 * n)
    _fall(tag, constants, constants.gravity, state)
    _warm_start(tag, constants, state, rest, work)
    n_touching = _find_contacts(tag, constants, floor, constants.restitution, state, work)
    for _ in range(constants.iterations):
        _push_contacts(tag, constants, friction, state, work, n_touching)
        _pull_springs(tag, constants, state, work)
    _move(tag, constants, state, limited)


@kernel
def _fall(tag, constants, gravity, state):
    """V += h g."""
    if gravity is not None:
        for i in range(len(constants.inverse_mass)):
            if constants.inverse_mass[i] > 0:
                store(tag, state.vx, i, load(tag, state.vx, i) + gravity[0])
                store(tag, state.vy, i, load(tag, state.vy, i) + gravity[1])


@inlined
def _apply(tag, constants, state, a, b, p, ux, uy):
    """Give the impulse p u to node b and its opposite to node a."""
    ia, ib = constants.inverse_mass[a], constants.inverse_mass[b]
    dv = p * ia
    dvx, dvy = dv * ux, dv * uy
    store(tag, state.vx, a, load(tag, state.vx, a) - dvx)
    store(tag, state.vy, a, load(tag, state.vy, a) - dvy)
    if ia != ib:  # equal masses change their velocities alike
        dv = p * ib
        dvx, dvy = dv * ux, dv * uy
    store(tag, state.vx, b, load(tag, state.vx, b) + dvx)
    store(tag, state.vy, b, load(tag, state.vy, b) + dvy)


@kernel
def _warm_start(tag, constants, state, rest, work):
    """Unit vectors and biases at the current positions; apply the impulses of the step before."""
    for s in range(len(constants.a)):
        a, b = constants.a[s], constants.b[s]
        dx = load(tag, state.x, b) - load(tag, state.x, a)
        dy = load(tag, state.y, b) - load(tag, state.y, a)
        d = square_root(dx * dx + dy * dy)
        inverse = 1.0 / larger(d, splat(tag, CLOSEST))
        ux, uy = dx * inverse, dy * inverse
        store(tag, work.ux, s, ux)
        store(tag, work.uy, s, uy)
        store(tag, work.beta, s, (d - load(tag, rest, constants.rest_row[s])) * constants.gain[s])
        p = load(tag, work.impulse, s)
        _apply(tag, constants, state, a, b, p, ux, uy)


@kernel
def _find_contacts(tag, constants, floor, restitution, state, work):
    """Put nodes on the floor; list those that do not move up, with their rebound. Returns how many."""
    count = 0
    if floor is not None:
        nothing = splat(tag, 0.0)
        for i in range(len(constants.inverse_mass)):
            y = load(tag, state.y, i)
            below = y <= 0.0
            if constants.inverse_mass[i] > 0 and any_lane(below):
                vy = load(tag, state.vy, i)
                store(tag, state.y, i, select(below, 0.0, y))
                rebound = nothing
                if restitution is not None:
                    rebound = select(vy > -floor.threshold, 0.0, -restitution * vy)
                store(tag, work.rebound, i, select(below & (vy <= 0.0), rebound, np.nan))
                store(tag, work.q_n, i, nothing)
                store(tag, work.q_t, i, nothing)
                work.touching[count] = i
                count += 1
    return count


@kernel
def _push_contacts(tag, constants, friction, state, work, n_touching):
    """One pass over the contacts: friction with the normal impulse so far, then the normal impulse."""
    for j in range(n_touching):
        i = work.touching[j]
        rebound = load(tag, work.rebound, i)
        active = rebound >= 0.0
        q_n = load(tag, work.q_n, i)
        if friction is not None:
            vx, q_t = load(tag, state.vx, i), load(tag, work.q_t, i)
            limit = friction[i] * abs(q_n)
            limit = select(abs(vx) > constants.half_friction_speed, 0.5 * limit, limit)
            q = select(active, smaller(larger(q_t - vx, -limit), limit), q_t)
            store(tag, state.vx, i, vx + (q - q_t))
            store(tag, work.q_t, i, q)
        vy = load(tag, state.vy, i)
        q = select(active, q_n + rebound - vy, q_n)  # may pull: the author's law
        store(tag, state.vy, i, vy + (q - q_n))
        store(tag, work.q_n, i, q)


@kernel
def _pull_springs(tag, constants, state, work):
    """One pass over the springs, each correcting its own velocity: dP = -M (u.(v_b - v_a) + beta + gamma P)."""
    for s in range(len(constants.a)):
        a, b = constants.a[s], constants.b[s]
        ux, uy, p = load(tag, work.ux, s), load(tag, work.uy, s), load(tag, work.impulse, s)
        rate = ux * (load(tag, state.vx, b) - load(tag, state.vx, a)) + uy * (
            load(tag, state.vy, b) - load(tag, state.vy, a)
        )
        # what does not wait for the velocities stands in brackets of its own
        dp = -constants.mass[s] * (rate + (load(tag, work.beta, s) + constants.gamma[s] * p))
        store(tag, work.impulse, s, p + dp)
        _apply(tag, constants, state, a, b, dp, ux, uy)


@kernel
def _move(tag, constants, state, limited):
    """Move by h v, no further than the longest move; a cut move cuts the velocity and is counted."""
    cut = load(tag, limited, 0)
    for i in range(len(constants.inverse_mass)):
        vx, vy = load(tag, state.vx, i), load(tag, state.vy, i)
        squared = vx * vx + vy * vy
        far = squared > constants.top_speed * constants.top_speed
        if any_lane(far):
            scale = select(far, constants.top_speed / square_root(squared), 1.0)
            vx, vy = vx * scale, vy * scale
            store(tag, state.vx, i, vx)
            store(tag, state.vy, i, vy)
            cut = cut + select(far, 1.0, splat(tag, 0.0))
        store(tag, state.x, i, load(tag, state.x, i) + constants.h * vx)
        store(tag, state.y, i, load(tag, state.y, i) + constants.h * vy)
    store(tag, limited, 0, cut)
