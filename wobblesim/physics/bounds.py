"""Trusted bounds: within them a motion is taken for physics, beyond them for a failure of the integrator.

A method that blows up need not end in infinities: it may settle again, far away, and would be the best robot of all.
So every few steps the loop looks at each lane's fastest node, most strained spring and energy. Looking only reads the
state: a trial that stays inside has the bits it would have without.

The energy is what a body has gained since its start, kinetic, elastic and in the field of gravity: free fall gains
nothing however long it lasts, the floor gives nothing back that it was not given, and muscles can only do so much. It
is measured in units of `energy_scale`, the strain against rest lengths, so that both fit bodies of any size and units.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wobblesim.physics.contract import Array, Dtype, Method, System, plan_array
from wobblesim.physics.kernels import inlined, kernel
from wobblesim.physics.lanes import any_lane, larger, load, select, splat, square_root, store
from wobblesim.physics.scene import Physics

BOUNDS = ("", "energy", "strain", "speed", "number")
"""What a trial was found to have left, by its number in the kernel; of several the last named."""

# Rest lengths below this part of the body's mean count as this part: a spring of length 0 has no strain.
SHORTEST = 0.1
# Strain of all springs that rounding may amount to: without gravity, muscles or motion it is all the energy there is.
NOISE = 1e-3
# Part of the kinetic energy that does not count: in a long fall rounding amounts to more than a small body's scale.
ROUNDED = 0.01


class Bounds(NamedTuple):
    """Constants of a look, nodes in the order of the integrator's rows."""

    ahead: Any
    max_speed_squared: Any
    max_strain: Any
    max_energy: Any  # in all, kinetic, elastic and in the field of gravity
    half_mass: Array  # (n_nodes,): of what counts, 0 for a fixed node
    weight_x: Array  # (n_nodes,): m g, 0 for a fixed node
    weight_y: Array
    a: Array  # (n_springs,) int: rows of the ends
    b: Array
    rest_row: Array  # (n_springs,) int
    half_k: Array  # (n_springs,)
    per_length: Array  # (n_springs,): 1 over the length that a strain is measured against


def bounds_of(
    system: System, method: Method, physics: Physics, length: float, amplitude: float, dtype: Dtype
) -> Bounds:
    """The bounds of one system.

    Parameters
    ----------
    length : float
        Of the body, u.
    amplitude : float
        Largest relative change of a muscle's rest length at sign 1.
    """
    real, order = dtype.type, method.node_order
    mass = system.moving_mass
    row = np.argsort(order)[system.springs]
    speed, strain, gain = (
        np.inf if bound is None else bound for bound in (physics.max_speed, physics.max_strain, physics.max_energy)
    )
    energy = start_energy(system) + gain * energy_scale(system, length, amplitude) if gain < np.inf else np.inf
    with np.errstate(over="ignore"):  # a bound beyond single precision is none
        limits = [real(bound) for bound in (np.square(speed), strain, energy)]
    gx, gy = system.pull
    return Bounds(
        real(method.ahead), *limits,
        half_mass=(0.5 * (1.0 - ROUNDED) * mass[order]).astype(dtype),
        weight_x=(mass[order] * gx).astype(dtype), weight_y=(mass[order] * gy).astype(dtype),
        a=plan_array(row[:, 0]), b=plan_array(row[:, 1]), rest_row=plan_array(system.rest_row),
        half_k=(0.5 * system.k).astype(dtype), per_length=(1.0 / _measure(system)).astype(dtype),
    )  # fmt: skip


def _measure(system: System) -> Array:
    """The length (n_springs,) that each spring's strain is measured against."""
    rest = system.rest[system.rest_row]
    shortest = SHORTEST * rest.mean() if len(rest) else 0.0
    return np.maximum(rest, shortest or 1.0)


def _stretch(system: System) -> Array:
    """How much longer than at rest each spring is at the start, u."""
    a, b = system.springs.T
    return np.hypot(*(system.position[b] - system.position[a]).T) - system.rest[system.rest_row]


def _kinetic(system: System) -> float:
    return 0.5 * float(system.moving_mass @ (system.velocity**2).sum(axis=1))


def start_energy(system: System) -> float:
    """Energy at the start: kinetic, elastic, and in the field of gravity (0 at the origin)."""
    weight = system.moving_mass @ (system.position @ system.pull)
    return _kinetic(system) + 0.5 * float(system.k @ _stretch(system) ** 2) - float(weight)


def energy_scale(system: System, length: float, amplitude: float) -> float:
    """The energy that a body can be expected to deal with: the unit of `Physics.max_energy`.

    It is the sum of what it has at the start (motion, stretched springs, springs of the floor under nodes that start
    inside it), what lifts it by its own length and by its height above the floor, what its muscles store when they are
    held at one end of their range and pull towards the other, and a strain of 0.001 of all springs.
    """
    mass = system.moving_mass
    extent = np.hypot(*np.ptp(system.position, axis=0))
    lift = max(length, extent) + (max(0.0, system.position[:, 1].max()) if system.floor else 0.0)
    depth = np.minimum(system.position[:, 1], 0.0) if system.floor else np.zeros(system.n_nodes)
    inside = 0.5 * (system.floor.stiffness if system.floor else 0.0) * mass @ depth**2
    swing = np.zeros(len(system.rest))
    swing[system.muscle_row] = 2.0 * amplitude * np.abs(system.muscle_sign) * system.rest[system.muscle_row]
    stored = _stretch(system) ** 2 + swing[system.rest_row] ** 2 + (NOISE * system.rest[system.rest_row]) ** 2
    return _kinetic(system) + inside + mass.sum() * np.hypot(*system.pull) * lift + 0.5 * float(system.k @ stored)


@inlined
def measured(tag, bounds, state, rest, place):
    """Of each lane: the square of the greatest speed, the greatest strain, the energy, and a sum of all places.

    Written in place: ``place (2 n_nodes, width)``, room for the positions.
    """
    zero = splat(tag, 0.0)
    fastest, strain, energy, total = zero, zero, zero, zero
    for i in range(len(state.x)):
        vx, vy = load(tag, state.vx, i), load(tag, state.vy, i)
        x, y = load(tag, state.x, i) - bounds.ahead * vx, load(tag, state.y, i) - bounds.ahead * vy
        store(tag, place, 2 * i, x)
        store(tag, place, 2 * i + 1, y)
        squared = vx * vx + vy * vy
        fastest = larger(squared, fastest)
        energy = energy + (bounds.half_mass[i] * squared - (bounds.weight_x[i] * x + bounds.weight_y[i] * y))
        total = total + (x + y)
    for s in range(len(bounds.a)):
        a, b = 2 * bounds.a[s], 2 * bounds.b[s]
        dx, dy = load(tag, place, b) - load(tag, place, a), load(tag, place, b + 1) - load(tag, place, a + 1)
        stretch = square_root(dx * dx + dy * dy) - load(tag, rest, bounds.rest_row[s])
        strain = larger(abs(stretch) * bounds.per_length[s], strain)
        energy = energy + bounds.half_k[s] * (stretch * stretch)
    return fastest, strain, energy, total


@kernel
def look(tag, bounds, state, rest, place, watch):
    """Note the lanes that are found beyond a bound for the first time; return whether any is still inside.

    Written in place: `place`; row 1 of `watch`: the number of the bound, 0 where none was left.
    """
    fastest, strain, energy, total = measured(tag, bounds, state, rest, place)
    left = splat(tag, 0.0)
    if bounds.max_energy < np.inf:
        left = select(energy <= bounds.max_energy, left, 1.0)  # an energy that is not a number is beyond
    left = select(strain > bounds.max_strain, 2.0, left)
    left = select(fastest > bounds.max_speed_squared, 3.0, left)
    left = select(total - total <= 0.0, left, 4.0)  # neither infinite nor NaN
    before = load(tag, watch, 1)
    left = select(before > 0.0, before, left)
    store(tag, watch, 1, left)
    return any_lane(left <= 0.0)
