"""`midpoint`: the linearly implicit midpoint rule, solved exactly. The default.

Forces are taken at the midpoint that the velocity predicts, x_m = x + h/2 v; the linear system

    (M + sum_s (h c/2 + theta h²/2 k) u uᵀ) dv = h F(x_m, v)

accounts for what dv changes in them, along the springs only: the geometric stiffness, kept, damps rotation badly.
With weight 1/2 on the dashpots the method is of order 2 with damping too; theta > 1/2 on the springs moves the
stiffest modes away from ringing at -1 and costs no order, for its term is h² smaller. Impulses act along u between
points at x_m, so linear and angular momentum are kept to rounding (which float32 feels once h² k/m nears 1e7).

The floor's force is the mean over the part of the step that a node is pressed (`contact.swept_normal_force`), and
stands on the diagonal with weight 1/2: order 2 also through impacts.

Written for x_m, the step x += h (v + dv/2), v += dv becomes v += dv, x_m += h v: the state keeps x_m, half a step
ahead, and x need not be kept at all.

The system is solved by LDLᵀ in the elimination order of `ordering.eliminate`; nodes are numbered in that order here.
The factorisation looks left: each node collects what earlier ones have left, in registers, and is stored once.
"""

# pyright: reportPossiblyUnboundVariable=false
# (a scene with friction has a floor: what the one branch sets, the other may use)

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wobblesim.physics.contact import IN_THE_AIR, compliant_floor, swept_friction, swept_normal_force
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
from wobblesim.physics.lanes import LanesTag, any_lane, fma, larger, load, splat, square_root, store
from wobblesim.physics.ordering import Elimination, eliminate
from wobblesim.physics.scene import Physics


class Midpoint(NamedTuple):
    """Constants; nodes in elimination order, springs in the order of their blocks. None: the scene has no such term."""

    h: Any
    half_h: Any
    minus_free: Array  # (n_nodes,): -1, or 0 for a fixed node
    mass: Array  # (n_nodes,); of a fixed node any that is large beside its springs
    weight: Array | None  # (n_nodes, 2): h m g
    c_n: Array | None  # (n_nodes,): the floor's normal dashpots
    d_n: Array | None  # (n_nodes,): c_n/2 + h/4 k of the floor: what dv takes off its force
    d_t: Array | None  # (n_nodes,): c_t/2 + h/4 k
    first: Array  # (n_nodes + 1,) int: blocks of a node
    row: Array  # (n_blocks,) int: the later node of a block
    column: Array  # (n_blocks,) int: the earlier node of a block
    left_first: Array  # (n_nodes + 1,) int: blocks that earlier nodes have with a node
    left: Array  # (n_blocks,) int
    pair_first: Array  # (n_blocks + 1,) int: what earlier nodes change in a block
    pairs: Array  # (n_pairs, 2) int
    filled: Array  # (fill,) int: blocks without a spring
    a: Array  # (n_springs,) int: the earlier node of a spring
    b: Array  # (n_springs,) int: the later node
    block: Array  # (n_springs,) int
    shares: Array  # (n_springs,) bool: whether the spring before stands in the same block
    from_first: Array  # (n_nodes + 1,) int: springs from a node to later ones
    into_first: Array  # (n_nodes + 1,) int: springs from earlier nodes to a node
    into: Array  # (n_springs,) int
    sigma: Array  # (n_springs,): sqrt(s), s = h c/2 + theta h²/2 k
    stretch: Array  # (n_springs,): h k/sigma
    damping: Array | None  # (n_springs,): h c/s
    rest_row: Array  # (n_springs,) int


class Work(NamedTuple):
    """Rows of one block of lanes."""

    spring: Array  # (3 n_springs, width): w_x, w_y and g of each spring
    factor: Array  # (4 n_blocks, width): xx, xy, yx, yy of each block of the matrix; later of -L
    pivot: Array  # (3 n_nodes, width): -d_x, -D_xy/d_x, -d_y
    change: Array  # (2 n_nodes, width): -z; later -dv
    anchor: Array  # (n_nodes, width): where a node first pressed the floor, or IN_THE_AIR
    touched: Array  # (n_nodes,) int: whether some lane was at the floor in the step before


def prepare(system: System, physics: Physics, dtype: Dtype) -> Method:
    """Fill the constants of one system: order the nodes, sort the springs by block."""
    h, n = physics.dt, system.n_nodes
    plan = eliminate(system.springs, n)
    order, mass = plan.order, system.mass[plan.order]
    springs, block = _springs_by_block(system, plan)
    a, b = plan.column[block], plan.row[block]
    k = system.k[springs]
    c = np.zeros(len(k)) if system.c is None else system.c[springs]
    s = 0.5 * h * (c + physics.theta * h * k)
    # A fixed node moves nothing whatever its mass; this one keeps its pivots away from 0.
    inertia = mass + np.where(system.inverse_mass[order] > 0, 0.0, np.bincount(a, s, n) + np.bincount(b, s, n))
    floor, c_n, d_n, d_t = _floor(system, mass, h)

    cast = caster(dtype)
    constants = Midpoint(
        h=dtype.type(h), half_h=dtype.type(0.5 * h), minus_free=cast(np.where(system.inverse_mass[order] > 0, -1, 0)),
        mass=cast(inertia), weight=cast(system.gravity and h * np.outer(mass, system.gravity)),
        c_n=cast(c_n), d_n=cast(d_n), d_t=cast(d_t),
        first=plan_array(plan.first), row=plan_array(plan.row), column=plan_array(plan.column),
        left_first=plan_array(plan.left_first), left=plan_array(plan.left),
        pair_first=plan_array(plan.pair_first), pairs=plan_array(plan.pairs),
        filled=plan_array(np.setdiff1d(np.arange(plan.n_blocks), block)), a=plan_array(a), b=plan_array(b),
        block=plan_array(block), shares=np.diff(block, prepend=-1) == 0,
        from_first=plan_array(np.searchsorted(a, np.arange(n + 1))),
        into_first=plan_array(np.searchsorted(np.sort(b), np.arange(n + 1))),
        into=plan_array(np.argsort(b, kind="stable")),
        sigma=cast(np.sqrt(s)), stretch=cast(h * k / np.sqrt(s)), damping=cast(None if system.c is None else h * c / s),
        rest_row=plan_array(system.rest_row[springs]),
    )  # fmt: skip

    def workspace(tag: LanesTag, state: State) -> Work:
        return Work(
            spring=rows(3 * len(springs), tag), factor=rows(4 * plan.n_blocks, tag), pivot=rows(3 * n, tag),
            change=rows(2 * n, tag), anchor=rows(n, tag), touched=np.zeros(n, np.int64),
        )  # fmt: skip

    floor = floor and floor._make(map(cast, floor))
    return Method(constants, floor, cast(system.friction if system.friction is None else system.friction[order]),
                  order, 0.5 * h, workspace)  # fmt: skip


def _floor(system: System, mass: Array, h: float) -> tuple[Any, Any, Any, Any]:
    """The contact law's constants and what a change of velocity takes off its forces, normal and tangential."""
    if system.floor is None:
        return None, None, None, None
    floor, c_n = compliant_floor(system.floor, mass, h, system.leave_out)
    d = 0.25 * h * floor.k
    return floor, c_n, d + 0.5 * (0.0 if c_n is None else c_n), d + 0.5 * floor.c_t


def _springs_by_block(system: System, plan: Elimination) -> tuple[Array, Array]:
    """Springs sorted by the block they stand in, and those blocks."""
    place = np.empty(system.n_nodes, dtype=np.int64)
    place[plan.order] = np.arange(system.n_nodes)
    p, q = np.sort(place[system.springs], axis=1).T
    # blocks are numbered by column, then row: their places in this list are their numbers
    block = np.searchsorted(plan.column * system.n_nodes + plan.row, p * system.n_nodes + q)
    springs = np.argsort(block, kind="stable")
    return springs, block[springs]


INTEGRATOR = Integrator("midpoint", 2, "compliant", True, 1, prepare)


@step_of(Midpoint)
def _step(tag, constants, floor, friction, muscles, state, rest, limited, work, n):
    set_rest_lengths(tag, muscles, rest, 2 * n + 1)
    _pull(tag, constants, constants.damping, state, rest, work)
    _eliminate(tag, constants, constants.weight, floor, constants.c_n, friction, state, work)
    _substitute_and_move(tag, constants, state, work)


@kernel
def _pull(tag, constants, damping, state, rest, work):
    """Every spring at the midpoint: w = sqrt(s) u from the earlier to the later node, g = h f/sqrt(s), pulling.

    With them the spring adds ``w wᵀ`` to the blocks of its nodes, ``-w wᵀ`` to the block between them, ``g w`` to h F.
    """
    for e in constants.filled:
        for row in range(4 * e, 4 * e + 4):
            store(tag, work.factor, row, splat(tag, 0.0))
    for i in range(len(constants.a)):
        a, b = constants.a[i], constants.b[i]
        dx, dy = load(tag, state.x, b) - load(tag, state.x, a), load(tag, state.y, b) - load(tag, state.y, a)
        d = square_root(fma(dx, dx, dy * dy))
        inverse = constants.sigma[i] / larger(d, splat(tag, CLOSEST))
        wx, wy = dx * inverse, dy * inverse
        g = constants.stretch[i] * (d - load(tag, rest, constants.rest_row[i]))
        if damping is not None:
            vx = load(tag, state.vx, b) - load(tag, state.vx, a)
            vy = load(tag, state.vy, b) - load(tag, state.vy, a)
            g = fma(damping[i], fma(wx, vx, wy * vy), g)
        store(tag, work.spring, 3 * i, wx)
        store(tag, work.spring, 3 * i + 1, wy)
        store(tag, work.spring, 3 * i + 2, g)
        e = 4 * constants.block[i]
        xx, xy, yy = -wx * wx, -wx * wy, -wy * wy
        if constants.shares[i]:
            xx, xy = xx + load(tag, work.factor, e), xy + load(tag, work.factor, e + 1)
            yy = yy + load(tag, work.factor, e + 3)
        store(tag, work.factor, e, xx)
        store(tag, work.factor, e + 1, xy)
        store(tag, work.factor, e + 2, xy)
        store(tag, work.factor, e + 3, yy)


@kernel
def _eliminate(tag, constants, weight, floor, c_n, friction, state, work):
    """Assemble and factorise, node after node in elimination order.

    The two unknowns of a node are eliminated x first. With its 2x2 block D and its part r of h F, as far as earlier
    nodes have changed them,

        d_x = D_xx,   d_y = D_yy - D_xy²/d_x,   z_x = r_x/d_x,   z_y = (r_y - r_x D_xy/d_x)/d_y,

    and a row (a_x, a_y) of a later node becomes ``l_x = a_x/d_x``, ``l_y = (a_y - a_x D_xy/d_x)/d_y``. From every
    earlier node it is coupled to, a node has ``l d lᵀ`` taken off its block and ``l d z`` off its part of h F. What is
    stored are -d, -l and -z: every update is then one fused multiply-add. A fixed node has 1/d = 0: it takes nothing
    and gives nothing.
    """
    nothing = splat(tag, 0.0)
    for p in range(len(constants.mass)):
        # mass, weight and floor
        xx, xy, yy = splat(tag, constants.mass[p]), nothing, splat(tag, constants.mass[p])
        rx, ry = nothing, nothing
        if weight is not None:
            rx, ry = splat(tag, weight[p, 0]), splat(tag, weight[p, 1])
        if floor is not None:
            y, vy = load(tag, state.y, p), load(tag, state.vy, p)
            touches = any_lane(y - constants.half_h * abs(vy) < 0.0)
            if touches:
                f_n, part = swept_normal_force(floor, c_n, p, y, vy, constants.half_h)
                pressed = constants.h * part  # s
                ry, yy = fma(pressed, f_n, ry), fma(pressed, constants.d_n[p], yy)
        # springs
        for i in range(constants.from_first[p], constants.from_first[p + 1]):
            wx, wy, g = (
                load(tag, work.spring, 3 * i),
                load(tag, work.spring, 3 * i + 1),
                load(tag, work.spring, 3 * i + 2),
            )
            xx, xy, yy = fma(wx, wx, xx), fma(wx, wy, xy), fma(wy, wy, yy)
            rx, ry = fma(g, wx, rx), fma(g, wy, ry)
        for j in range(constants.into_first[p], constants.into_first[p + 1]):
            i = constants.into[j]
            wx, wy, g = (
                load(tag, work.spring, 3 * i),
                load(tag, work.spring, 3 * i + 1),
                load(tag, work.spring, 3 * i + 2),
            )
            xx, xy, yy = fma(wx, wx, xx), fma(wx, wy, xy), fma(wy, wy, yy)
            rx, ry = fma(-g, wx, rx), fma(-g, wy, ry)
        # friction: its limit is that of the normal force as dv leaves it, if no other node moved
        if friction is not None:
            if touches:
                x, vx = load(tag, state.x, p), load(tag, state.vx, p)
                anchor = load(tag, work.anchor, p) if work.touched[p] else splat(tag, IN_THE_AIR)
                limit = friction[p] * (f_n - constants.d_n[p] * (ry / yy))
                f_t, sticks, anchor = swept_friction(
                    floor, constants.d_t, p, x, vx, vy, part, constants.half_h, anchor, limit, rx, xx
                )
                rx, xx = fma(pressed, f_t, rx), fma(sticks, constants.d_t[p], xx)
                store(tag, work.anchor, p, anchor)
            work.touched[p] = touches
        # what earlier nodes left: a and c are rows x and y of -L
        for j in range(constants.left_first[p], constants.left_first[p + 1]):
            e = constants.left[j]
            q = constants.column[e]
            dx, dy = load(tag, work.pivot, 3 * q), load(tag, work.pivot, 3 * q + 2)
            ax, ay = load(tag, work.factor, 4 * e), load(tag, work.factor, 4 * e + 1)
            cx, cy = load(tag, work.factor, 4 * e + 2), load(tag, work.factor, 4 * e + 3)
            zx, zy = load(tag, work.change, 2 * q), load(tag, work.change, 2 * q + 1)
            dax, day, dcx, dcy = dx * ax, dy * ay, dx * cx, dy * cy
            xx, xy = xx + fma(day, ay, dax * ax), xy + fma(dcy, ay, dcx * ax)
            yy = yy + fma(dcy, cy, dcx * cx)
            rx, ry = rx + fma(day, zy, dax * zx), ry + fma(dcy, zy, dcx * zx)
        # pivots; d_y = determinant/d_x, so that the two divisions do not wait for each other
        determinant = fma(xx, yy, -(xy * xy))
        ix, iy = constants.minus_free[p] / xx, constants.minus_free[p] * xx / determinant
        l = xy * ix
        store(tag, work.pivot, 3 * p, -xx)
        store(tag, work.pivot, 3 * p + 1, l)
        store(tag, work.pivot, 3 * p + 2, determinant * ix)
        store(tag, work.change, 2 * p, rx * ix)
        store(tag, work.change, 2 * p + 1, fma(l, rx, ry) * iy)
        # rows of later nodes
        for e in range(constants.first[p], constants.first[p + 1]):
            ax, ay = load(tag, work.factor, 4 * e), load(tag, work.factor, 4 * e + 1)
            cx, cy = load(tag, work.factor, 4 * e + 2), load(tag, work.factor, 4 * e + 3)
            for j in range(constants.pair_first[e], constants.pair_first[e + 1]):
                f, g = constants.pairs[j, 0], constants.pairs[j, 1]
                q = constants.column[f]
                dx, dy = load(tag, work.pivot, 3 * q), load(tag, work.pivot, 3 * q + 2)
                fax, fay = dx * load(tag, work.factor, 4 * f), dy * load(tag, work.factor, 4 * f + 1)
                fcx, fcy = dx * load(tag, work.factor, 4 * f + 2), dy * load(tag, work.factor, 4 * f + 3)
                gax, gay = load(tag, work.factor, 4 * g), load(tag, work.factor, 4 * g + 1)
                gcx, gcy = load(tag, work.factor, 4 * g + 2), load(tag, work.factor, 4 * g + 3)
                ax, ay = fma(gay, fay, fma(gax, fax, ax)), fma(gay, fcy, fma(gax, fcx, ay))
                cx, cy = fma(gcy, fay, fma(gcx, fax, cx)), fma(gcy, fcy, fma(gcx, fcx, cy))
            store(tag, work.factor, 4 * e, ax * ix)
            store(tag, work.factor, 4 * e + 1, fma(l, ax, ay) * iy)
            store(tag, work.factor, 4 * e + 2, cx * ix)
            store(tag, work.factor, 4 * e + 3, fma(l, cx, cy) * iy)


@kernel
def _substitute_and_move(tag, constants, state, work):
    """Substitute back, dv_p = z - sum_e L_eᵀ dv_e, y before x, and move: v += dv, x_m += h v."""
    for j in range(len(constants.mass)):
        p = len(constants.mass) - 1 - j
        gx, gy = load(tag, work.change, 2 * p), load(tag, work.change, 2 * p + 1)
        for e in range(constants.first[p], constants.first[p + 1]):
            q = constants.row[e]
            qx, qy = load(tag, work.change, 2 * q), load(tag, work.change, 2 * q + 1)
            gx = fma(load(tag, work.factor, 4 * e + 2), qy, fma(load(tag, work.factor, 4 * e), qx, gx))
            gy = fma(load(tag, work.factor, 4 * e + 3), qy, fma(load(tag, work.factor, 4 * e + 1), qx, gy))
        gx = fma(load(tag, work.pivot, 3 * p + 1), gy, gx)
        store(tag, work.change, 2 * p, gx)
        store(tag, work.change, 2 * p + 1, gy)
        vx, vy = load(tag, state.vx, p) - gx, load(tag, state.vy, p) - gy
        store(tag, state.vx, p, vx)
        store(tag, state.vy, p, vy)
        store(tag, state.x, p, fma(constants.h, vx, load(tag, state.x, p)))
        store(tag, state.y, p, fma(constants.h, vy, load(tag, state.y, p)))
