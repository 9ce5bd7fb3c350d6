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
from wobblesim.physics.lanes import select
from wobblesim.physics.scene import Floor

# The dashpot of a floor with restitution 0: a rebound of 1e-4 of the impact's speed.
MOST_DAMPED = 50.0
# Damping ratio of the tangential spring. Measured on the gait (64 random behaviours, 5 s, dt 0.01, against dt 0.0005):
# mean error 0.0113 body lengths at 1.0, 0.0056 at 0.3, 0.0054 at 0.2, 0.0056 at 0.15, 0.0046 at 0.05.
TANGENTIAL_DAMPING = 0.2


class CompliantFloor(NamedTuple):
    """Constants of the law, rows in the integrator's node order."""

    k: NDArray[Any]  # (n_nodes,)
    c_n: NDArray[Any]  # (n_nodes,)
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


def compliant_floor(floor: Floor, mass: NDArray[Any], dtype: Any, dt: float = 0.0) -> CompliantFloor:
    """Constants of a floor for nodes of these masses.

    A step dt bounds the dashpots, for `midpoint` weighs them by 1/2: beyond ``2 m/dt`` a plastic impact would throw
    the node back, beyond ``m/dt`` a node that slips to a stop would be turned round. Without a step there is no bound.
    """
    k = floor.stiffness * mass
    critical = 2.0 * np.sqrt(k * mass)
    most = mass / dt if dt else np.inf
    return CompliantFloor(
        k=k.astype(dtype),
        c_n=np.minimum(damping_ratio_of(floor.restitution) * critical, 2.0 * most).astype(dtype),
        c_t=np.minimum(TANGENTIAL_DAMPING * critical, most).astype(dtype),
    )


@inlined
def normal_force(floor, i, y, vy):
    """Force of the floor on node i at height y, upwards; 0 where it does not press."""
    force = -floor.k[i] * y - floor.c_n[i] * vy
    return select((y < 0.0) & (force > 0.0), force, 0.0)


@inlined
def tangential_force(floor, i, x, vx, anchor, limit):
    """Friction on node i, where it slips, and the anchor that it leaves behind.

    `limit` is mu times the normal force; a node that is not pressed (limit 0) takes its anchor along.
    """
    dashpot = floor.c_t[i] * vx
    trial = floor.k[i] * (anchor - x) - dashpot
    slips = abs(trial) > limit
    force = select(slips, select(trial > 0.0, limit, -limit), trial)
    dragged = select(slips, x + (force + dashpot) / floor.k[i], anchor)
    pressed = limit > 0.0
    return select(pressed, force, 0.0), slips, select(pressed, dragged, x)
