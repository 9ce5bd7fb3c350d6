"""The contract between an integrator and the loop that drives it.

An integrator is a small file with

- a `NamedTuple` of its constants (arrays and scalars of one precision), whose *type* selects the step;
- a function ``prepare(system, physics, dtype) -> Method`` that fills it, once per simulate call;
- a step, registered with ``@step_of(Constants)``: plain Python on lanes, compiled for each width and precision.

The step sees rows of lanes and scalars, and nothing of files, bodies or robots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba.core.extending import overload
from numpy.typing import NDArray

from wobblesim.physics.kernels import kernel
from wobblesim.physics.lanes import LanesTag, aligned_zeros, load, store
from wobblesim.physics.scene import Floor, Physics, Scene
from wobblesim.robot.body import Body

Array = NDArray[Any]
Dtype = np.dtype[Any]

# Nodes closer than this (u) lose their direction: u shrinks to (0, 0) where they coincide. Far above the distance whose
# square underflows in float32 (1e-19).
CLOSEST = 1e-15


class State(NamedTuple):
    """What evolves, in the integrator's node order; each ``(n_nodes, width)``. Written in place by a step.

    Positions may be kept ahead of time, at x + `Method.ahead` v.
    """

    x: Array
    y: Array
    vx: Array
    vy: Array


class Muscles(NamedTuple):
    """What changes the rest lengths. A spring's rest length is a row; springs that share one share its cost."""

    row: Array  # (n_muscle_rows,) int: rows of `rest` that move
    group: Array  # (n_muscle_rows,) int
    length: Array  # (n_muscle_rows,) u
    signed_length: Array  # (n_muscle_rows,) u: sign times length
    sine: Array  # (n_groups, width): the part of each signal that goes with the clock's sine
    cosine: Array  # (n_groups, width)
    clock: Array  # (n_half_steps, 2): sine and cosine of the gait's phase at each half step


@dataclass(frozen=True, eq=False)
class System:
    """A body in a scene, as the arrays that every integrator needs (float64).

    Springs between two fixed nodes, and those without stiffness, are left out: they move nothing. None stands for a
    term that the scene does not have; it is compiled to nothing.
    """

    position: Array  # (n_nodes, 2) u
    velocity: Array  # (n_nodes, 2) u/s
    inverse_mass: Array  # (n_nodes,), 0 for a fixed node
    mass: Array  # (n_nodes,)
    friction: Array | None  # (n_nodes,)
    springs: Array  # (n_springs, 2) int
    k: Array  # (n_springs,)
    c: Array | None  # (n_springs,): 2 zeta sqrt(k m_r), m_r the reduced mass (a fixed node's mass is infinite)
    rest_row: Array  # (n_springs,) int: row of the rest length
    rest: Array  # (n_rest,) u: rest lengths at signal 0
    muscle_row: Array  # (n_muscle_rows,) int
    muscle_group: Array  # (n_muscle_rows,) int
    muscle_sign: Array  # (n_muscle_rows,)
    gravity: tuple[float, float] | None
    floor: Floor | None
    leave_out: bool  # whether terms without effect are left out, here and in the integrator

    @property
    def n_nodes(self) -> int:
        """Number of point masses."""
        return len(self.position)

    @property
    def moving_mass(self) -> Array:
        """Mass (n_nodes,), 0 for a fixed node."""
        return np.where(self.inverse_mass > 0, self.mass, 0.0)

    @property
    def pull(self) -> Array:
        """Gravity (2,) in u/s², zeros if the scene has none."""
        return np.zeros(2) if self.gravity is None else np.array(self.gravity)


def system_of(body: Body, scene: Scene, gravity_factor: float, leave_out: bool = True) -> System:
    """The arrays of an adapted body in a scene; with `leave_out` only of the terms that do something."""
    free = ~body.fixed
    inverse_mass = np.where(free, 1.0 / body.mass, 0.0)
    moves = free[body.springs].any(axis=1) & (body.stiffness > 0)
    springs, k, zeta = body.springs[moves], body.stiffness[moves], body.damping_ratio[moves]
    group, sign = np.full(body.n_springs, -1), np.zeros(body.n_springs)
    group[body.muscle_spring], sign[body.muscle_spring] = body.muscle_group, body.muscle_sign
    kinds, rest_row = np.unique(
        np.stack([group[moves], sign[moves], body.rest_length[moves]], axis=1), axis=0, return_inverse=True
    )
    muscle_row = np.flatnonzero(kinds[:, 0] >= 0)
    c = 2.0 * zeta * np.sqrt(k / inverse_mass[springs].sum(axis=1))
    gravity = np.array(scene.gravity_vector) * gravity_factor
    friction = body.friction if scene.floor else np.zeros(0)
    return System(
        position=body.position,
        velocity=np.where(free[:, None], body.velocity, 0.0),
        inverse_mass=inverse_mass,
        mass=body.mass,
        friction=friction if friction.any() or (scene.floor and not leave_out) else None,
        springs=springs,
        k=k,
        c=c if c.any() or not leave_out else None,
        rest_row=rest_row.reshape(-1),
        rest=kinds[:, 2].copy(),
        muscle_row=muscle_row,
        muscle_group=kinds[muscle_row, 0].astype(np.int64),
        muscle_sign=kinds[muscle_row, 1].copy(),
        gravity=tuple(gravity) if gravity.any() or not leave_out else None,
        floor=scene.floor,
        leave_out=leave_out,
    )


@dataclass(frozen=True, eq=False)
class Method:
    """An integrator prepared for one system.

    Attributes
    ----------
    constants : NamedTuple
        Its type selects the step.
    floor, friction : NamedTuple or None, (n_nodes,) or None
        Constants of the contact law; None is compiled to nothing.
    node_order : (n_nodes,) int
        Node of each row of the state.
    ahead : float
        How far ahead of time the state's positions are kept, s.
    workspace : callable
        ``workspace(tag, state) -> NamedTuple`` of rows for one block of lanes, ready for the first step.
    """

    constants: Any
    floor: Any
    friction: Array | None
    node_order: Array
    ahead: float
    workspace: Callable[[LanesTag, State], Any]


@dataclass(frozen=True)
class Integrator:
    """An entry of the registry.

    Attributes
    ----------
    name : str
    order : int
        Of convergence on smooth scenes.
    contact : str
        ``rigid`` or ``compliant``.
    stable_when_stiff : bool
        Whether any dt is stable on a linear spring, in exact arithmetic.
    registers : int
        Vector registers a row should span: more than one where a step waits for results (see benchmarks/).
    prepare : callable
        ``prepare(system, physics, dtype) -> Method``; ValueError if the integrator refuses the step.
    """

    name: str
    order: int
    contact: str
    stable_when_stiff: bool
    registers: int
    prepare: Callable[[System, Physics, Dtype], Method]


_STEPS: dict[type, Callable[..., None]] = {}


def step_of(constants: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a function as the step of the integrator whose constants have this type."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        _STEPS[constants] = function
        return function

    return register


def step(
    tag: LanesTag, constants: Any, floor: Any, friction: Any, muscles: Any, state: State, rest: Array,
    limited: Array, work: Any, n: int,
) -> None:  # fmt: skip
    """Move every lane from t = n h to (n + 1) h; `state`, `rest`, `limited` and `work` are written in place.

    Row 0 of `limited` counts the node-steps that a limiter of the method has cut.
    """
    _STEPS[type(constants)](tag, constants, floor, friction, muscles, state, rest, limited, work, n)


@overload(step)
def _step(tag, constants, floor, friction, muscles, state, rest, limited, work, n):
    return _STEPS[constants.instance_class]


@kernel
def set_rest_lengths(tag, muscles, rest, half_step):
    """Write the muscles' rest lengths ``L (1 + sign alpha(t))`` at t = half_step h/2 into their rows of `rest`."""
    if muscles is not None:
        sine, cosine = muscles.clock[half_step, 0], muscles.clock[half_step, 1]
        for i in range(len(muscles.row)):
            g = muscles.group[i]
            alpha = sine * load(tag, muscles.sine, g) + cosine * load(tag, muscles.cosine, g)
            store(tag, rest, muscles.row[i], muscles.length[i] + muscles.signed_length[i] * alpha)


def plan_array(numbers: Any) -> Array:
    """Indices for kernels. Unsigned: for negative ones Numba spends 13 % of `midpoint`'s elimination."""
    return np.asarray(numbers).astype(np.uint32)


def caster(dtype: Dtype) -> Callable[[Any], Any]:
    """What makes constants of one precision of numbers; a term that the scene does not have stays None."""
    return lambda numbers: None if numbers is None else np.asarray(numbers, dtype)


def rows(n_rows: int, tag: LanesTag) -> Array:
    """Workspace of n_rows rows of lanes."""
    return aligned_zeros(n_rows, tag)
