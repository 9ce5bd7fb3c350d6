"""Compliant contact with true sticking: the law of granular simulation (Cundall & Strack 1979).

At penetration p a floor of stiffness k = m kappa pushes a node of mass m back with ``f_n = max(0, k p - c_n v_y)`` (it
never pulls) and holds it to the anchor where it touched down with ``f_t = k (anchor - x) - c_t v_x``. Beyond Coulomb's
limit ``mu f_n`` the node slips and drags its anchor along.

A node at rest lies ``g/kappa`` deep; below the friction angle it creeps by exactly nothing, displaced elastically by
``g sin(angle)/kappa``; it rebounds with the floor's restitution in the limit of small steps. The stiffness goes with
the mass so that a step resolves the impact of a light node as well as that of a heavy one, and a robot of twice the
mass and stiffness moves alike.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from wobblesim.physics.kernels import inlined
from wobblesim.physics.lanes import larger, select
from wobblesim.physics.scene import Floor

IN_THE_AIR = np.inf  # anchor of a node that does not press the floor
LEAST = 1e-30  # u: a shorter way through the floor's surface is none

# The dashpot of a floor with restitution 0: a rebound of 1e-4 of the impact's speed.
MOST_DAMPED = 50.0
# Damping ratio of the tangential spring. Measured on the gait (64 random behaviours, 5 s, dt 0.02, against dt 0.0003):
# mean error 0.0197 body lengths at 1.0, 0.0097 at 0.5, 0.0078 at 0.2, 0.0088 at 0.05.
TANGENTIAL_DAMPING = 0.2


class CompliantFloor(NamedTuple):
    """Constants of the law, rows in the integrator's node order; the normal dashpots stand apart: they may be None."""

    k: NDArray[Any]  # (n_nodes,)
    c_t: NDArray[Any]  # (n_nodes,)


def rebound(zeta: float) -> float:
    """Restitution of a node on a spring and dashpot that push but never pull, without gravity.

    The contact ends when the force, not the penetration, falls to zero (Schwager & Pöschel 2007, equation 21):
    with w = sqrt(|1 - zeta²|), the time of the end is ``atan2(2 zeta w, 2 zeta² - 1)/w`` (under-damped) and the
    speed ``exp(-zeta t)`` of the impact's.
    """
    if zeta < 1.0:
        w = math.sqrt(1.0 - zeta**2)
        duration = math.atan2(2.0 * zeta * w, 2.0 * zeta**2 - 1.0) / w if w > 0 else 2.0
        return math.exp(-zeta * duration)
    if zeta == 1.0:
        return math.exp(-2.0)
    w = math.sqrt(zeta**2 - 1.0)
    return math.exp(-zeta / w * 2.0 * math.asinh(w))


def damping_ratio_of(restitution: float) -> float:
    """Damping ratio of the normal dashpot that rebounds with a restitution; at most `MOST_DAMPED`."""
    if restitution <= rebound(MOST_DAMPED):
        return MOST_DAMPED
    if restitution >= 1.0:
        return 0.0
    return float(brentq(lambda zeta: rebound(zeta) - restitution, 0.0, MOST_DAMPED, xtol=1e-14, rtol=1e-14))


def compliant_floor(
    floor: Floor, mass: NDArray[Any], dt: float = 0.0, leave_out: bool = True
) -> tuple[CompliantFloor, NDArray[Any] | None]:
    """Constants of a floor for nodes of these masses, and the dashpots c_n, None if the floor has none.

    A step dt bounds the dashpots, for `midpoint` weighs them by 1/2: beyond ``2 m/dt`` a plastic impact would throw
    the node back, beyond ``m/dt`` a node that slips to a stop would be turned round. Without a step there is no bound.
    """
    k = floor.stiffness * mass
    critical = 2.0 * np.sqrt(k * mass)
    most = mass / dt if dt else np.inf
    c_n = np.minimum(damping_ratio_of(floor.restitution) * critical, 2.0 * most)
    return CompliantFloor(
        k, np.minimum(TANGENTIAL_DAMPING * critical, most)
    ), c_n if c_n.any() or not leave_out else None


@inlined
def normal_force(floor, c_n, i, y, vy):
    """Force of the floor on node i at height y, upwards; 0 where it does not press."""
    force = -floor.k[i] * y
    if c_n is not None:
        force = force - c_n[i] * vy
    return select((y < 0.0) & (force > 0.0), force, 0.0)


@inlined
def tangential_force(floor, i, x, vx, anchor, limit):
    """Friction on node i, where it slips, and the anchor that it leaves behind.

    `limit` is mu times the normal force; a node that is not pressed (limit 0) takes its anchor along.
    """
    trial = floor.k[i] * (anchor - x) - floor.c_t[i] * vx
    force, slips, anchor = coulomb(floor, i, x, vx, anchor, limit, trial, trial)
    return force, slips, select(limit > 0.0, anchor, x)


@inlined
def coulomb(floor, i, x, vx, anchor, limit, trial, met):
    """`trial` where `met` does not exceed the limit, else the limit and the anchor dragged along; 0 at limit 0."""
    slips = abs(met) > limit
    force = select(slips, select(met > 0.0, limit, -limit), trial)
    dragged = select(slips, x + (force + floor.c_t[i] * vx) / floor.k[i], anchor)
    return select(limit > 0.0, force, 0.0), slips, dragged


# --- the same forces, swept over a step -----------------------------------------------------------------------
#
# A step that knows the force at its midpoint only is early or late by half a step at every touch-down. Here node i
# moves past the height y at the middle of the step with its velocity, and meets the floor for a part of the step only.
# Means are taken over that part; the step's impulse is h times the part times the mean.


@inlined
def swept_normal_force(floor, c_n, i, y, vy, half_h):
    """Mean normal force on node i while it is pressed, and the part of the step that it is; 0 and 0 if never."""
    reach = half_h * abs(vy)
    lowest, highest = y - reach, y + reach
    pull, surface = 0.0 * y, 0.0 * y  # the force is above zero below the surface
    if c_n is not None:
        pull = -c_n[i] * vy
        surface = select(pull < 0.0, pull / floor.k[i], 0.0)
    whole = highest <= surface
    force = pull - floor.k[i] * (0.5 * (lowest + select(whole, highest, surface)))
    part = select(whole, 1.0, (surface - lowest) / larger(reach + reach, LEAST + 0.0 * y))
    pressed = lowest < surface
    return select(pressed, force, 0.0), select(pressed, part, 0.0)


@inlined
def swept_friction(floor, d_t, i, x, vx, vy, part, half_h, anchor, limit, impulse, inertia):
    """Mean friction on node i while it is pressed, for how long it sticks, and its anchor.

    `anchor` and what becomes of it are IN_THE_AIR for a node that is not pressed; a node that lands sets its anchor
    where the pressed part of the step begins, which is its end if the node comes down. Whether it slips is decided by
    the force as the step leaves it, not as it begins: held by a spring that is stiff for the step, a node at rest would
    else slip back and forth for ever. The step takes ``d_t dv`` off the force, and dv is the sum of `impulse`, all but
    the friction's, and the friction's, over `inertia` and what friction adds to it.
    """
    off_centre = half_h * (1.0 - part) * vx
    middle = x + select(vy < 0.0, off_centre, -off_centre)
    anchor = select(anchor < IN_THE_AIR, anchor, middle - half_h * part * vx)
    time = (half_h + half_h) * part
    trial = floor.k[i] * (anchor - middle) - floor.c_t[i] * vx
    met = (inertia * trial - d_t[i] * impulse) / (inertia + time * d_t[i])
    force, slips, anchor = coulomb(floor, i, middle, vx, anchor, limit, trial, met)
    pressed = (part > 0.0) & (limit > 0.0)
    return force, select(pressed & ~slips, time, 0.0), select(pressed, anchor, IN_THE_AIR)
