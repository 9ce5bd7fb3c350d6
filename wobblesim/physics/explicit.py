"""`explicit`: the classical Runge-Kutta method of order 4, the honest and slow reference for everything smooth.

It refuses a step beyond its stability limit, which the stiffest damped mode of the body sets.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import bmat, coo_array, csc_array, eye_array
from scipy.sparse.linalg import eigs

from wobblesim.physics.contact import compliant_floor, normal_force, tangential_force
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
from wobblesim.physics.kernels import kernel
from wobblesim.physics.lanes import LanesTag, larger, load, splat, square_root, store
from wobblesim.physics.scene import Physics

DENSE_NODES = 12  # up to here all eigenvalues are found, beyond only the largest


class Explicit(NamedTuple):
    """Constants; nodes and springs in their own order."""

    h: Any
    weight: Array  # (4,): of each stage's slope, h/6, h/3, h/3, h/6
    ahead: Array  # (4,): from the start of the step to the next stage, h/2, h/2, h, 0
    stage: Array  # (4,) int: half steps from the start of the step
    inverse_mass: Array  # (n_nodes,)
    gravity: Array | None  # (2,)
    c_n: Array | None  # (n_nodes,): the floor's normal dashpots
    a: Array  # (n_springs,) int
    b: Array
    k: Array  # (n_springs,)
    c: Array | None
    rest_row: Array  # (n_springs,) int


class Work(NamedTuple):
    """Rows of one block of lanes, each (n_nodes, width)."""

    at: State  # the stage
    sum: State  # start of the step plus the weighted slopes so far
    ax: Array
    ay: Array
    anchor: Array


def prepare(system: System, physics: Physics, dtype: Dtype) -> Method:
    """Fill the constants of one system; ValueError if the step is beyond the stability limit."""
    h, n = physics.dt, system.n_nodes
    _refuse_unstable(system, h)
    a, b = system.springs.T
    floor = c_n = None
    if system.floor:
        floor, c_n = compliant_floor(system.floor, system.mass, leave_out=system.leave_out)

    cast = caster(dtype)
    constants = Explicit(
        h=dtype.type(h), weight=cast(h * np.array([1, 2, 2, 1]) / 6), ahead=cast(h * np.array([0.5, 0.5, 1.0, 0.0])),
        stage=np.array([0, 1, 1, 2]), inverse_mass=cast(system.inverse_mass), gravity=cast(system.gravity),
        c_n=cast(c_n), a=plan_array(a), b=plan_array(b), k=cast(system.k), c=cast(system.c),
        rest_row=plan_array(system.rest_row),
    )  # fmt: skip

    def workspace(tag: LanesTag, state: State) -> Work:
        stage, total = (State(*(rows(n, tag) for _ in range(4))) for _ in range(2))
        anchor = rows(n, tag)
        anchor[:] = state.x
        return Work(at=stage, sum=total, ax=rows(n, tag), ay=rows(n, tag), anchor=anchor)

    floor = floor and floor._make(map(cast, floor))
    return Method(constants, floor, cast(system.friction), np.arange(n), 0.0, workspace)


INTEGRATOR = Integrator("explicit", 4, "compliant", False, 1, prepare)


def _refuse_unstable(system: System, h: float) -> None:
    limit, omega = stability_limit(system)
    if h > limit:
        raise ValueError(
            f"explicit is unstable at dt {h:g} s: its limit for this body is {limit:.3g} s "
            f"(fastest mode {omega:.4g} rad/s); take a smaller dt, or an integrator for stiff springs (midpoint)"
        )


def stability_limit(system: System) -> tuple[float, float]:
    """Largest stable step about the built shape, and the angular frequency of the fastest undamped mode.

    The modes are those of the springs, and of each node alone on a compliant floor.

    Returns
    -------
    limit : float
        s; infinite for a body without springs or floor.
    omega : float
        rad/s.
    """
    omega, modes = _body_modes(system)
    if system.floor:
        floor, c_n = compliant_floor(system.floor, system.mass)
        k = floor.k * system.inverse_mass
        for c in (floor.c_t * system.inverse_mass, (0.0 * k if c_n is None else c_n) * system.inverse_mass):
            root = np.sqrt((c / 2) ** 2 - k + 0j)
            modes = np.concatenate([modes, -c / 2 + root, -c / 2 - root])
        omega = max(omega, float(np.sqrt(k.max())))
    fastest = np.abs(modes).max(initial=0.0)
    if fastest == 0.0:
        return np.inf, 0.0
    modes = modes[np.abs(modes) > 1e-6 * fastest]  # rigid motions
    low, high = 0.0, 4.0 / fastest  # the region of stability lies within |z| < 4
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _is_stable(middle * modes) else (low, middle)
    return low, omega


def _is_stable(z: Array) -> bool:
    growth = np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))
    return bool(growth.max() <= 1 + 1e-7)


def _body_modes(system: System) -> tuple[float, Array]:
    """Fastest undamped frequency (rad/s) and the fastest damped modes (1/s), linearised about the built shape."""
    if len(system.springs) == 0:
        return 0.0, np.zeros(0)
    stiffness, damping = (
        _mobility(system, system.k),
        _mobility(system, 0.0 * system.k if system.c is None else system.c),
    )
    zero, one = csc_array(stiffness.shape), eye_array(stiffness.shape[0])
    first_order = csc_array(bmat([[zero, one], [-stiffness, -damping]]))
    if system.n_nodes <= DENSE_NODES:
        squares = np.linalg.eigvals(stiffness.toarray())
        return float(np.sqrt(np.abs(squares).max())), np.linalg.eigvals(first_order.toarray())
    # Arnoldi iteration from a fixed start, so that the limit is the same every time.
    squares = eigs(stiffness, k=1, v0=np.cos(np.arange(stiffness.shape[0])), return_eigenvectors=False)
    modes = eigs(first_order, k=12, v0=np.cos(np.arange(first_order.shape[0])), return_eigenvectors=False)
    return float(np.sqrt(np.abs(squares).max())), modes


def _mobility(system: System, strength: Array) -> csc_array:
    """M⁻¹ sum_s strength_s u uᵀ over the springs."""
    a, b = system.springs.T
    d = system.position[b] - system.position[a]
    length = np.maximum(np.hypot(*d.T), CLOSEST)
    u = d / length[:, None]
    block = strength[:, None, None] * u[:, :, None] * u[:, None, :]  # (n_springs, 2, 2)
    row, column, value = [], [], []
    for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        for s in range(2):
            for t in range(2):
                row.append(2 * i + s)
                column.append(2 * j + t)
                value.append(sign * block[:, s, t] * system.inverse_mass[i])
    size = 2 * system.n_nodes
    entries = (np.concatenate(value), (np.concatenate(row), np.concatenate(column)))
    return csc_array(coo_array(entries, shape=(size, size)))


@step_of(Explicit)
def _step(tag, constants, floor, friction, muscles, state, rest, limited, work, n):
    _copy(tag, state, work.at)
    _copy(tag, state, work.sum)
    for stage in range(4):
        set_rest_lengths(tag, muscles, rest, 2 * n + constants.stage[stage])
        _accelerate(tag, constants, constants.gravity, constants.c, floor, constants.c_n, friction, rest, work)
        _advance_stage(tag, constants, state, work, stage)
    _copy(tag, work.sum, state)
    if friction is not None:
        _drag_anchors(tag, constants, floor, constants.c_n, friction, state, work)


@kernel
def _copy(tag, source, target):
    for i in range(len(source.x)):
        store(tag, target.x, i, load(tag, source.x, i))
        store(tag, target.y, i, load(tag, source.y, i))
        store(tag, target.vx, i, load(tag, source.vx, i))
        store(tag, target.vy, i, load(tag, source.vy, i))


@kernel
def _accelerate(tag, constants, gravity, damping, floor, c_n, friction, rest, work):
    """Accelerations at the stage: gravity, floor, springs."""
    at = work.at
    for i in range(len(constants.inverse_mass)):
        ax, ay = splat(tag, 0.0), splat(tag, 0.0)
        if gravity is not None:
            ax, ay = splat(tag, gravity[0]), splat(tag, gravity[1])
        if floor is not None:
            f_n = normal_force(floor, c_n, i, load(tag, at.y, i), load(tag, at.vy, i))
            ay = ay + f_n * constants.inverse_mass[i]
            if friction is not None:
                x, vx, anchor = load(tag, at.x, i), load(tag, at.vx, i), load(tag, work.anchor, i)
                f_t, _, _ = tangential_force(floor, i, x, vx, anchor, friction[i] * f_n)
                ax = ax + f_t * constants.inverse_mass[i]
        store(tag, work.ax, i, ax)
        store(tag, work.ay, i, ay)
    for s in range(len(constants.a)):
        a, b = constants.a[s], constants.b[s]
        dx, dy = load(tag, at.x, b) - load(tag, at.x, a), load(tag, at.y, b) - load(tag, at.y, a)
        d = square_root(dx * dx + dy * dy)
        inverse = 1.0 / larger(d, splat(tag, CLOSEST))
        ux, uy = dx * inverse, dy * inverse
        f = constants.k[s] * (d - load(tag, rest, constants.rest_row[s]))
        if damping is not None:
            vx, vy = load(tag, at.vx, b) - load(tag, at.vx, a), load(tag, at.vy, b) - load(tag, at.vy, a)
            f = f + damping[s] * (ux * vx + uy * vy)
        fx, fy = f * ux, f * uy
        ia, ib = constants.inverse_mass[a], constants.inverse_mass[b]
        store(tag, work.ax, a, load(tag, work.ax, a) + fx * ia)
        store(tag, work.ay, a, load(tag, work.ay, a) + fy * ia)
        store(tag, work.ax, b, load(tag, work.ax, b) - fx * ib)
        store(tag, work.ay, b, load(tag, work.ay, b) - fy * ib)


@kernel
def _advance_stage(tag, constants, state, work, stage):
    """Add the stage's slope to the sum; move on to the next stage from the start of the step."""
    w, ahead = constants.weight[stage], constants.ahead[stage]
    for i in range(len(constants.inverse_mass)):
        if constants.inverse_mass[i] > 0:
            vx, vy = load(tag, work.at.vx, i), load(tag, work.at.vy, i)
            ax, ay = load(tag, work.ax, i), load(tag, work.ay, i)
            store(tag, work.sum.x, i, load(tag, work.sum.x, i) + w * vx)
            store(tag, work.sum.y, i, load(tag, work.sum.y, i) + w * vy)
            store(tag, work.sum.vx, i, load(tag, work.sum.vx, i) + w * ax)
            store(tag, work.sum.vy, i, load(tag, work.sum.vy, i) + w * ay)
            store(tag, work.at.x, i, load(tag, state.x, i) + ahead * vx)
            store(tag, work.at.y, i, load(tag, state.y, i) + ahead * vy)
            store(tag, work.at.vx, i, load(tag, state.vx, i) + ahead * ax)
            store(tag, work.at.vy, i, load(tag, state.vy, i) + ahead * ay)


@kernel
def _drag_anchors(tag, constants, floor, c_n, friction, state, work):
    """After the step: anchors of slipping nodes follow, those of nodes in the air go along."""
    for i in range(len(constants.inverse_mass)):
        f_n = normal_force(floor, c_n, i, load(tag, state.y, i), load(tag, state.vy, i))
        x, vx, anchor = load(tag, state.x, i), load(tag, state.vx, i), load(tag, work.anchor, i)
        _, _, anchor = tangential_force(floor, i, x, vx, anchor, friction[i] * f_n)
        store(tag, work.anchor, i, anchor)
