"""What integrators are compared with: a closed form, SciPy on the same equations, or the limit of small steps.

The equations are written here once more, with NumPy and sparse matrices on all trials at a time, and share nothing
with the kernels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.sparse import csr_array

from wobblesim.numerics.scenes import Case
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait

Floats = NDArray[np.float64]

TOLERANCE = 1e-10
"""Relative, and absolute in u and u/s, of DOP853."""

LOOSER = 100.0
"""The solution with a tolerance so many times larger says how far off the reference may be."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A solution and one of half its resolution, whose distance bounds its error.

    Attributes
    ----------
    source : str
        What it is, in words.
    positions, coarser : (n_frames, n_nodes, 2, n_trials)
        u.
    displacement, coarser_displacement : (n_trials,)
        Of the body's centre along x, body lengths.
    """

    source: str
    positions: Floats
    coarser: Floats
    displacement: Floats
    coarser_displacement: Floats


@dataclass(frozen=True, eq=False)
class Equations:
    """Springs, muscles and gravity of an adapted body, for any number of trials at once; no floor.

    Positions and velocities are (n_nodes, 2, n_trials), lengths (n_springs, n_trials).
    """

    body: Body
    behaviours: Floats
    gait: Gait
    gravity: tuple[float, float]
    ends: csr_array  # (n_springs, n_nodes): -1 at a, +1 at b
    damping: Floats  # (n_springs,)

    @classmethod
    def of(cls, case: Case) -> Equations:
        """The equations of a case."""
        body = case.body.adapted(case.morphology)
        gx, gy = case.scene.gravity_vector
        factor = case.morphology.gravity
        return cls(body, case.behaviours, case.gait, (gx * factor, gy * factor), _ends(body), damping(body))

    def lengths(self, time: float) -> Floats:
        """Rest lengths at a time."""
        body, n_groups = self.body, self.body.n_groups
        amplitude, offset = self.behaviours[:, :n_groups].T, self.behaviours[:, n_groups:].T
        alpha = self.gait.max_amplitude * amplitude * np.sin(2 * np.pi * (time / self.gait.period + offset))
        factor = np.ones((body.n_springs, len(self.behaviours)))
        factor[body.muscle_spring] += body.muscle_sign[:, None] * alpha[body.muscle_group]
        return body.rest_length[:, None] * factor

    def acceleration(self, time: float, position: Floats, velocity: Floats) -> Floats:
        """What springs and gravity do to the nodes, u/s²."""
        body = self.body
        apart, approach = self._across(position), self._across(velocity)
        distance = np.hypot(apart[:, 0], apart[:, 1])
        unit = apart / distance[:, None]
        tension = body.stiffness[:, None] * (distance - self.lengths(time))
        tension += self.damping[:, None] * (unit * approach).sum(axis=1)
        pull = unit * tension[:, None]
        force = -(self.ends.T @ pull.reshape(body.n_springs, -1)).reshape(position.shape)
        acceleration = force / body.mass[:, None, None] + np.array(self.gravity)[:, None]
        acceleration[body.fixed] = 0.0
        return acceleration

    def energy(self, time: float, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Energy of motion and springs, and that of weight above y = 0, (n_trials,) each."""
        body = self.body
        stretch = np.hypot(*np.moveaxis(self._across(position), 1, 0)) - self.lengths(time)
        mass = np.where(body.fixed, 0.0, body.mass)[:, None]
        motion = 0.5 * (mass * (velocity**2).sum(axis=1)).sum(axis=0)
        height = sum(g * position[:, axis] for axis, g in enumerate(self.gravity))
        return motion + 0.5 * (body.stiffness[:, None] * stretch**2).sum(axis=0), -(mass * height).sum(axis=0)

    def start(self) -> tuple[Floats, Floats]:
        """Positions and velocities at time 0."""
        shape = (*self.body.position.shape, len(self.behaviours))
        velocity = np.where(self.body.fixed[:, None], 0.0, self.body.velocity)
        return tuple(np.broadcast_to(part[..., None], shape).copy() for part in (self.body.position, velocity))  # type: ignore[return-value]

    def _across(self, nodes: Floats) -> Floats:
        """Differences along the springs, (n_springs, 2, n_trials)."""
        return (self.ends @ nodes.reshape(len(nodes), -1)).reshape(-1, *nodes.shape[1:])


def _ends(body: Body) -> csr_array:
    m = body.n_springs
    row, column = np.tile(np.arange(m), 2), body.springs.T.ravel()
    return csr_array((np.repeat([-1.0, 1.0], m), (row, column)), shape=(m, body.n_nodes))


def damping(body: Body) -> Floats:
    """Dashpots ``c = 2 zeta sqrt(k m_r)``, (n_springs,); 0 between two fixed nodes."""
    inverse = np.where(body.fixed, 0.0, 1.0 / body.mass)[body.springs].sum(axis=1)
    reduced = np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0)
    return 2.0 * body.damping_ratio * np.sqrt(body.stiffness * reduced)


def solve(equations: Equations, times: Floats, *, tolerance: float = TOLERANCE, method: str = "DOP853") -> Floats:
    """Solve the equations with SciPy.

    Returns
    -------
    (n_times, 2, n_nodes, 2, n_trials)
        Positions in u, then velocities in u/s.

    Raises
    ------
    RuntimeError
        If SciPy gives up.
    """
    start = np.stack(equations.start())

    def slope(time: float, flat: Floats) -> Floats:
        position, velocity = flat.reshape(start.shape)
        return np.stack([velocity, equations.acceleration(time, position, velocity)]).ravel()

    span = (float(times[0]), float(times[-1]))
    solution = solve_ivp(slope, span, start.ravel(), method, times, rtol=tolerance, atol=tolerance)
    if not solution.success:
        raise RuntimeError(f"SciPy's {method} gave up: {solution.message}")
    return solution.y.T.reshape(-1, *start.shape)


def damped_oscillator(stretch: float, omega: float, damping_ratio: float, times: Floats) -> Floats:
    """Stretch (n_times,) of ``x'' = -omega² x - 2 zeta omega x'`` released at rest, for zeta below 1."""
    swing = omega * math.sqrt(1.0 - damping_ratio**2)
    decay = np.exp(-damping_ratio * omega * times)
    return stretch * decay * (np.cos(swing * times) + damping_ratio * omega / swing * np.sin(swing * times))


def reference_of(case: Case, contact: str, run: Callable[[Physics], Trials], finest: float) -> Reference:
    """The reference of a case for the integrators of one law of contact.

    Parameters
    ----------
    case : Case
    contact : str
        `Integrator.contact`; without a floor there is none, and all integrators share one reference.
    run : callable
        ``run(physics) -> Trials`` of this case, frames recorded.
    finest : float
        Step of the reference where there is a floor, s.
    """
    if case.has_floor:
        return _limit(contact, run, finest)
    if case.name == "oscillator":
        return _closed_form(case)
    return _by_scipy(case)


def by_steps(case: Case, physics: Physics, threads: int | None = None) -> Trials:
    """Simulate a case in whole blocks of lanes, frames recorded.

    Raises
    ------
    ValueError
        If the integrator refuses the step, or frames do not fall on whole steps.
    """
    return simulate(
        case.body, case.behaviours, morphology=case.morphology, scene=case.scene, physics=physics, gait=case.gait,
        duration=case.duration, record_every=_steps_in(case.frame, physics.dt), threads=threads,
        width=full_width(physics),
    )  # fmt: skip


def full_width(physics: Physics) -> int:
    """Lanes of a full block."""
    return INTEGRATORS[physics.integrator].registers * 64 // np.dtype(physics.precision).itemsize


def limit_of(contact: str) -> str:
    """The integrator whose small steps are the reference of a contact law: the first that takes steps of any size."""
    return next(
        (i.name for i in INTEGRATORS.values() if i.contact == contact and i.stable_when_stiff),
        next(i.name for i in INTEGRATORS.values() if i.contact == contact),
    )


def _steps_in(frame: float, dt: float) -> int:
    steps = round(frame / dt)
    if steps == 0 or abs(steps * dt - frame) > 1e-9 * frame:
        raise ValueError(f"frames every {frame:g} s do not fall on whole steps of {dt:g} s")
    return steps


def _limit(contact: str, run: Callable[[Physics], Trials], finest: float) -> Reference:
    physics = Physics(integrator=limit_of(contact), dt=finest, precision="float64", refinements=0)
    fine, coarse = run(physics), run(replace(physics, dt=2.0 * finest))
    assert fine.positions is not None
    assert coarse.positions is not None
    source = f"{physics.integrator} at dt {finest:g} s, float64"
    return Reference(source, fine.positions, coarse.positions, fine.displacement, coarse.displacement)


def _closed_form(case: Case) -> Reference:
    body = case.body
    rest, ratio = float(body.rest_length[0]), float(body.damping_ratio[0])
    stretch = body.position[1, 0] - rest
    omega = math.sqrt(body.stiffness[0] / body.mass[1])
    positions = np.zeros((len(case.times), 2, 2, len(case.behaviours)))
    positions[:, 1, 0] = rest + damped_oscillator(stretch, omega, ratio, case.times)[:, None]
    return _known("closed form", case, positions, positions)


def _by_scipy(case: Case) -> Reference:
    equations = Equations.of(case)
    fine, coarse = (solve(equations, case.times, tolerance=t * TOLERANCE)[:, 0] for t in (1.0, LOOSER))
    return _known(f"SciPy's DOP853 at rtol {TOLERANCE:g}", case, fine, coarse)


def _known(source: str, case: Case, positions: Floats, coarser: Floats) -> Reference:
    shift, coarser_shift = (displacement(case.body, p) for p in (positions, coarser))
    return Reference(source, positions, coarser, shift, coarser_shift)


def displacement(body: Body, positions: Any) -> Floats:
    """Of the centre along x between the first and the last frame, (n_trials,) body lengths."""
    centre = positions[[0, -1]][:, body.center, 0].mean(axis=1)
    return (centre[1] - centre[0]) / body.body_length
