"""`midpoint`: the linearly implicit midpoint rule, solved exactly. The default.

Forces are taken at the midpoint that the velocity predicts, x_m = x + h/2 v; the linear system

    (M + sum_s (h c/2 + theta h²/2 k) u uᵀ) dv = h F(x_m, v)

accounts for what dv changes in them, along the springs only: the geometric stiffness, kept, damps rotation badly.
With weight 1/2 on the dashpots the method is of order 2 with damping too; theta > 1/2 on the springs moves the
stiffest modes away from ringing at -1 and costs no order, for its term is h² smaller. Impulses act along u between
points at x_m, so linear and angular momentum are kept to rounding (which float32 feels once h² k/m nears 1e5).

Written for x_m, the step x += h (v + dv/2), v += dv becomes v += dv, x_m += h v: the state keeps x_m, half a step
ahead, and x need not be kept at all.

The system is factorised as block LDLᵀ, 2x2 blocks a node, in the elimination order of `ordering.eliminate`; nodes
are numbered in that order here.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wobblesim.physics.contact import compliant_floor, normal_force, tangential_force
from wobblesim.physics.contract import (
    CLOSEST,
    Array,
    Dtype,
    Integrator,
    Method,
    State,
    System,
    rows,
    set_rest_lengths,
    step_of,
)
from wobblesim.physics.kernels import inlined, kernel
from wobblesim.physics.lanes import LanesTag, any_lane, larger, load, select, splat, square_root, store
from wobblesim.physics.ordering import Elimination, eliminate
from wobblesim.physics.scene import Physics

IN_THE_AIR = np.inf  # anchor of a node that does not press the floor


class Midpoint(NamedTuple):
    """Constants; nodes in elimination order, springs in the order of their blocks."""

    h: Any
    half_h: Any
    theta_h: Any  # theta h²/2
    free: Array  # (n_nodes,): 1, or 0 for a fixed node
    mass: Array  # (n_nodes,)
    weight_x: Array  # (n_nodes,): h m g
    weight_y: Array
    first: Array  # (n_nodes + 1,) int: blocks of a node
    row: Array  # (n_blocks,) int: the later node of a block
    spring_first: Array  # (n_nodes + 1,) int: springs from a node to later ones
    other: Array  # (n_springs,) int: the later node of a spring
    block: Array  # (n_springs,) int
    shares: Array  # (n_springs,) bool: whether the spring before stands in the same block
    filled: Array  # (fill,) int: blocks without a spring
    hk: Array  # (n_springs,): h k
    hc: Array  # (n_springs,): h c
    minus_s: Array  # (n_springs,): -(h c/2 + theta h²/2 k)
    rest_row: Array  # (n_springs,) int
    target_first: Array  # (n_blocks,) int
    target: Array  # (n_updates,) int


class Work(NamedTuple):
    """Rows of one block of lanes."""

    diagonal: Array  # (3 n_nodes, width): xx, xy, yy of each diagonal block; later of its inverse
    rhs: Array  # (2 n_nodes, width): h F; later dv
    block: Array  # (4 n_blocks, width): xx, xy, yx, yy of each block; later of the factor
    anchor: Array  # (n_nodes, width): where a node first pressed the floor, or IN_THE_AIR
    touched: Array  # (n_nodes,) int: whether some lane was at the floor in the step before


def prepare(system: System, physics: Physics, dtype: Dtype) -> Method:
    """Fill the constants of one system: order the nodes, sort the springs by block."""
    real, h = dtype.type, physics.dt
    plan = eliminate(system.springs, system.n_nodes)
    order = plan.order
    springs, block = _springs_by_block(system, plan)
    k, c = system.k[springs], system.c[springs]
    mass = system.mass[order]
    free = system.inverse_mass[order] > 0
    gx, gy = system.gravity
    constants = Midpoint(
        h=real(h), half_h=real(0.5 * h), theta_h=real(0.5 * physics.theta * h * h),
        free=free.astype(dtype), mass=mass.astype(dtype),
        weight_x=(h * gx * mass).astype(dtype), weight_y=(h * gy * mass).astype(dtype),
        first=plan.first, row=plan.row, spring_first=np.searchsorted(block, plan.first), other=plan.row[block],
        block=block, shares=np.diff(block, prepend=-1) == 0, filled=np.setdiff1d(np.arange(plan.n_blocks), block),
        hk=(h * k).astype(dtype), hc=(h * c).astype(dtype),
        minus_s=(-0.5 * h * (c + physics.theta * h * k)).astype(dtype), rest_row=system.rest_row[springs],
        target_first=plan.target_first, target=plan.target,
    )  # fmt: skip
    floor = compliant_floor(system.floor, mass, dtype, h) if system.floor else None
    friction = system.friction[order].astype(dtype) if floor and system.friction.any() else None

    def workspace(tag: LanesTag, state: State) -> Work:
        n = system.n_nodes
        blocks = rows(4 * plan.n_blocks, tag)
        return Work(rows(3 * n, tag), rows(2 * n, tag), blocks, rows(n, tag), np.zeros(n, np.int64))

    return Method(constants, floor, friction, order, 0.5 * h, workspace)


def _springs_by_block(system: System, plan: Elimination) -> tuple[Array, Array]:
    """Springs sorted by the block they stand in, and those blocks."""
    place = np.empty(system.n_nodes, dtype=np.int64)
    place[plan.order] = np.arange(system.n_nodes)
    p, q = np.sort(place[system.springs], axis=1).T
    column = np.repeat(np.arange(system.n_nodes), np.diff(plan.first))
    # blocks are numbered by column, then row: their places in this list are their numbers
    block = np.searchsorted(column * system.n_nodes + plan.row, p * system.n_nodes + q)
    springs = np.argsort(block, kind="stable")
    return springs, block[springs]


INTEGRATOR = Integrator("midpoint", 2, "compliant", True, 1, prepare)


@step_of(Midpoint)
def _step(tag, constants, floor, friction, muscles, state, rest, limited, work, n):
    set_rest_lengths(tag, muscles, rest, 2 * n + 1)
    _begin(tag, constants, floor, friction, state, work)
    _assemble(tag, constants, state, rest, work)
    _factorise(tag, constants, work)
    _solve_and_move(tag, constants, state, work)


@kernel
def _begin(tag, constants, floor, friction, state, work):
    """Start matrix and right-hand side with mass, weight and the floor."""
    for p in range(len(constants.mass)):
        store(tag, work.rhs, 2 * p, splat(tag, constants.weight_x[p]))
        store(tag, work.rhs, 2 * p + 1, splat(tag, constants.weight_y[p]))
        store(tag, work.diagonal, 3 * p, splat(tag, constants.mass[p]))
        store(tag, work.diagonal, 3 * p + 1, splat(tag, 0.0))
        store(tag, work.diagonal, 3 * p + 2, splat(tag, constants.mass[p]))
        if floor is not None:
            _press(tag, constants, floor, friction, state, work, p)


@inlined
def _press(tag, constants, floor, friction, state, work, p):
    """The floor under node p: forces, and what they change with dv, on the diagonal."""
    y = load(tag, state.y, p)
    touches = any_lane(y < 0.0)
    if touches:
        f_n = normal_force(floor, p, y, load(tag, state.vy, p))
        s_n = constants.half_h * floor.c_n[p] + constants.theta_h * floor.k[p]
        rhs, diagonal = load(tag, work.rhs, 2 * p + 1), load(tag, work.diagonal, 3 * p + 2)
        store(tag, work.rhs, 2 * p + 1, rhs + constants.h * f_n)
        store(tag, work.diagonal, 3 * p + 2, diagonal + select(f_n > 0.0, s_n, splat(tag, 0.0)))
        if friction is not None:
            x, vx, limit = load(tag, state.x, p), load(tag, state.vx, p), friction[p] * f_n
            anchor = load(tag, work.anchor, p) if work.touched[p] else splat(tag, IN_THE_AIR)
            anchor = select(anchor < IN_THE_AIR, anchor, x)  # set where the node first presses
            f_t, slips, anchor = tangential_force(floor, p, x, vx, anchor, limit)
            s_t = constants.half_h * floor.c_t[p] + constants.theta_h * floor.k[p]
            sticks = (limit > 0.0) & ~slips
            rhs, diagonal = load(tag, work.rhs, 2 * p), load(tag, work.diagonal, 3 * p)
            store(tag, work.rhs, 2 * p, rhs + constants.h * f_t)
            store(tag, work.diagonal, 3 * p, diagonal + select(sticks, s_t, splat(tag, 0.0)))
            store(tag, work.anchor, p, select(limit > 0.0, anchor, IN_THE_AIR))
    work.touched[p] = touches


@kernel
def _assemble(tag, constants, state, rest, work):
    """Add every spring's force and stiffness at the midpoint; p is the end that is eliminated first."""
    for e in constants.filled:
        for row in range(4 * e, 4 * e + 4):
            store(tag, work.block, row, splat(tag, 0.0))
    for p in range(len(constants.mass)):
        xp, yp = load(tag, state.x, p), load(tag, state.y, p)
        vxp, vyp = load(tag, state.vx, p), load(tag, state.vy, p)
        fxp, fyp = load(tag, work.rhs, 2 * p), load(tag, work.rhs, 2 * p + 1)
        xxp, xyp = load(tag, work.diagonal, 3 * p), load(tag, work.diagonal, 3 * p + 1)
        yyp = load(tag, work.diagonal, 3 * p + 2)
        for i in range(constants.spring_first[p], constants.spring_first[p + 1]):
            q = constants.other[i]
            dx, dy = load(tag, state.x, q) - xp, load(tag, state.y, q) - yp
            d = square_root(dx * dx + dy * dy)
            inverse = 1.0 / larger(d, splat(tag, CLOSEST))
            ux, uy = dx * inverse, dy * inverse
            rate = ux * (load(tag, state.vx, q) - vxp) + uy * (load(tag, state.vy, q) - vyp)
            hf = constants.hk[i] * (d - load(tag, rest, constants.rest_row[i])) + constants.hc[i] * rate
            # the force pulls p towards q and q towards p
            fx, fy = hf * ux, hf * uy
            fxp, fyp = fxp + fx, fyp + fy
            store(tag, work.rhs, 2 * q, load(tag, work.rhs, 2 * q) - fx)
            store(tag, work.rhs, 2 * q + 1, load(tag, work.rhs, 2 * q + 1) - fy)
            # -s u uᵀ couples them, +s u uᵀ stands on both diagonals
            sx, sy = constants.minus_s[i] * ux, constants.minus_s[i] * uy
            xx, xy, yy = sx * ux, sx * uy, sy * uy
            xxp, xyp, yyp = xxp - xx, xyp - xy, yyp - yy
            store(tag, work.diagonal, 3 * q, load(tag, work.diagonal, 3 * q) - xx)
            store(tag, work.diagonal, 3 * q + 1, load(tag, work.diagonal, 3 * q + 1) - xy)
            store(tag, work.diagonal, 3 * q + 2, load(tag, work.diagonal, 3 * q + 2) - yy)
            row = 4 * constants.block[i]
            if constants.shares[i]:
                xx, xy = xx + load(tag, work.block, row), xy + load(tag, work.block, row + 1)
                yy = yy + load(tag, work.block, row + 3)
            store(tag, work.block, row, xx)
            store(tag, work.block, row + 1, xy)
            store(tag, work.block, row + 2, xy)
            store(tag, work.block, row + 3, yy)
        store(tag, work.rhs, 2 * p, fxp)
        store(tag, work.rhs, 2 * p + 1, fyp)
        store(tag, work.diagonal, 3 * p, xxp)
        store(tag, work.diagonal, 3 * p + 1, xyp)
        store(tag, work.diagonal, 3 * p + 2, yyp)


@kernel
def _factorise(tag, constants, work):
    """Eliminate node after node: with D the diagonal block of p and B_e its blocks,

    L_e = B_e D⁻¹,   A[e, f] -= B_e L_fᵀ,   A[e, e] -= L_e B_eᵀ,   rhs_e -= B_e z,   z = D⁻¹ rhs_p.

    L_e replaces B_e, z replaces rhs_p. A fixed node has D⁻¹ = 0: it takes nothing and gives nothing.
    """
    for p in range(len(constants.mass)):
        xx, xy, yy = (
            load(tag, work.diagonal, 3 * p), load(tag, work.diagonal, 3 * p + 1), load(tag, work.diagonal, 3 * p + 2)
        )  # fmt: skip
        inverse = constants.free[p] / (xx * yy - xy * xy)
        ixx, ixy, iyy = yy * inverse, -xy * inverse, xx * inverse
        rx, ry = load(tag, work.rhs, 2 * p), load(tag, work.rhs, 2 * p + 1)
        zx, zy = ixx * rx + ixy * ry, ixy * rx + iyy * ry
        store(tag, work.rhs, 2 * p, zx)
        store(tag, work.rhs, 2 * p + 1, zy)
        for e in range(constants.first[p], constants.first[p + 1]):
            q = constants.row[e]
            bxx, bxy = load(tag, work.block, 4 * e), load(tag, work.block, 4 * e + 1)
            byx, byy = load(tag, work.block, 4 * e + 2), load(tag, work.block, 4 * e + 3)
            t = constants.target_first[e]
            for f in range(constants.first[p], e):
                lxx, lxy = load(tag, work.block, 4 * f), load(tag, work.block, 4 * f + 1)
                lyx, lyy = load(tag, work.block, 4 * f + 2), load(tag, work.block, 4 * f + 3)
                g = 4 * constants.target[t]
                t += 1
                store(tag, work.block, g, load(tag, work.block, g) - (bxx * lxx + bxy * lxy))
                store(tag, work.block, g + 1, load(tag, work.block, g + 1) - (bxx * lyx + bxy * lyy))
                store(tag, work.block, g + 2, load(tag, work.block, g + 2) - (byx * lxx + byy * lxy))
                store(tag, work.block, g + 3, load(tag, work.block, g + 3) - (byx * lyx + byy * lyy))
            lxx, lxy = bxx * ixx + bxy * ixy, bxx * ixy + bxy * iyy
            lyx, lyy = byx * ixx + byy * ixy, byx * ixy + byy * iyy
            store(tag, work.block, 4 * e, lxx)
            store(tag, work.block, 4 * e + 1, lxy)
            store(tag, work.block, 4 * e + 2, lyx)
            store(tag, work.block, 4 * e + 3, lyy)
            store(tag, work.diagonal, 3 * q, load(tag, work.diagonal, 3 * q) - (lxx * bxx + lxy * bxy))
            store(tag, work.diagonal, 3 * q + 1, load(tag, work.diagonal, 3 * q + 1) - (lxx * byx + lxy * byy))
            store(tag, work.diagonal, 3 * q + 2, load(tag, work.diagonal, 3 * q + 2) - (lyx * byx + lyy * byy))
            store(tag, work.rhs, 2 * q, load(tag, work.rhs, 2 * q) - (bxx * zx + bxy * zy))
            store(tag, work.rhs, 2 * q + 1, load(tag, work.rhs, 2 * q + 1) - (byx * zx + byy * zy))


@kernel
def _solve_and_move(tag, constants, state, work):
    """Substitute back, dv_p = z - sum_e L_eᵀ dv_e, and move: v += dv, x_m += h v."""
    for j in range(len(constants.mass)):
        p = len(constants.mass) - 1 - j
        dvx, dvy = load(tag, work.rhs, 2 * p), load(tag, work.rhs, 2 * p + 1)
        for e in range(constants.first[p], constants.first[p + 1]):
            q = constants.row[e]
            qx, qy = load(tag, work.rhs, 2 * q), load(tag, work.rhs, 2 * q + 1)
            dvx = dvx - (load(tag, work.block, 4 * e) * qx + load(tag, work.block, 4 * e + 2) * qy)
            dvy = dvy - (load(tag, work.block, 4 * e + 1) * qx + load(tag, work.block, 4 * e + 3) * qy)
        store(tag, work.rhs, 2 * p, dvx)
        store(tag, work.rhs, 2 * p + 1, dvy)
        vx, vy = load(tag, state.vx, p) + dvx, load(tag, state.vy, p) + dvy
        store(tag, state.vx, p, vx)
        store(tag, state.vy, p, vy)
        store(tag, state.x, p, load(tag, state.x, p) + constants.h * vx)
        store(tag, state.y, p, load(tag, state.y, p) + constants.h * vy)
