"""One spring: how far the step of each integrator reaches, by theory and as measured.

An oscillator of angular frequency omega and damping ratio zeta is multiplied by a 2x2 matrix in every step, whatever
the integrator; it grows where the matrix's spectral radius is above 1. With s = omega h and w = v/omega:

- `explicit` (RK4): the exponential series of ``s [[0, 1], [-1, -2 zeta]]`` to degree 4;
- `impulse` is linearly implicit Euler on one spring: ``w' = w - s (x' + 2 zeta w')``, ``x' = x + s w'``;
- `midpoint`: ``dw = -(s (x + s w/2) + 2 zeta s w)/D``, ``D = 1 + zeta s + theta s²/2``, ``x' = x + s (w + dw/2)``.

Across a taut spring nothing is implicit: a node between two springs of tension T and length L swings across them with
``omega² = 2 T/(L m)``, and `midpoint` leaves that out of its matrix (theta = 0 above), which it must, for the geometric
stiffness, kept, would damp rotation. So it has a limit there, 2, as `impulse` has, which moves by ``w' = w - s x``,
``x' = x + s w'``. A muscle that is strained by e has T/L = k e: the limit is felt where h sqrt(2 k e/m) nears 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import simulate
from wobblesim.robot.body import Body

ZETAS = (0.0, 1.0)
LADDER = (0.1, 0.8, 1.0, 2.0, 5.0, 10.0, 100.0, 1e4)
"""Values of omega h that are run (ST-1)."""

LEAST, MOST = 0.05, 2e4  # omega h of the curves
GROWS = 1.0 + 1e-7
"""A spectral radius above this grows: doubling takes seven million steps at most."""

STEP = 0.01  # s; only omega h matters
THROW = 1e6  # u a step: what is left of it by rounding must not come near the distance at which springs lose direction
STRAIN = 0.1  # of the taut springs
SWING = 1e-9  # of their length, so small that a thousandfold swing is still linear


def amplification(integrator: str, s: float, zeta: float, theta: float) -> NDArray[np.float64]:
    """The matrix (2, 2) by which one step multiplies (x, v/omega), s being omega h.

    Raises
    ------
    ValueError
        If no theory is written down for the integrator.
    """
    if integrator == "explicit":
        z = s * np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]])
        one = np.eye(2)
        return one + z @ (one + z / 2 @ (one + z / 3 @ (one + z / 4)))
    if integrator == "impulse":
        denominator = 1.0 + 2.0 * zeta * s + s * s
        w = np.array([-s, 1.0]) / denominator
        return np.array([[1.0 + s * w[0], s * w[1]], w])
    if integrator == "midpoint":
        dw = -np.array([s, 0.5 * s * s + 2.0 * zeta * s]) / (1.0 + zeta * s + 0.5 * theta * s * s)
        return np.array([[1.0 + 0.5 * s * dw[0], s + 0.5 * s * dw[1]], [dw[0], 1.0 + dw[1]]])
    raise ValueError(f"no theory of one spring for {integrator!r}")


def amplification_across(integrator: str, s: float) -> NDArray[np.float64]:
    """As `amplification`, of a small swing across taut springs."""
    if integrator == "impulse":
        return np.array([[1.0 - s * s, s], [-s, 1.0]])
    return amplification(integrator, s, zeta=0.0, theta=0.0)


def spectral_radius(integrator: str, s: float, zeta: float, theta: float) -> float:
    """Largest absolute eigenvalue of a step."""
    return _radius(amplification(integrator, s, zeta, theta))


def _radius(matrix: NDArray[np.float64]) -> float:
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def theory_limit(integrator: str, zeta: float, theta: float) -> float:
    """Largest omega h without growth; infinite if there is none up to `MOST`."""
    return _limit(lambda s: spectral_radius(integrator, s, zeta, theta) > GROWS)


def measured_limit(physics: Physics, zeta: float) -> float:
    """As `theory_limit`, from runs of the program."""
    return _limit(lambda s: measured_radius(physics, s, zeta) > GROWS)


def theory_limit_across(integrator: str) -> float:
    """Largest omega h without growth across taut springs."""
    return _limit(lambda s: _radius(amplification_across(integrator, s)) > GROWS)


def measured_limit_across(physics: Physics) -> float:
    """As `theory_limit_across`, from runs of the program; NaN where another limit comes first.

    A swing has grown if it comes to a thousand times its start within 400 steps.
    """
    if not INTEGRATORS[physics.integrator].stable_when_stiff:
        return math.nan  # its limit along the springs refuses the step long before

    return _limit(lambda s: not np.abs(run_across(physics, s, 400)).max() < 1e3 * SWING)


def _limit(grows: Callable[[float], bool]) -> float:
    low, high = 0.0, math.inf
    for s in np.geomspace(LEAST, MOST, 60):
        if grows(float(s)):
            high = float(s)
            break
        low = float(s)
    while high < math.inf and high - low > 1e-5 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return math.inf if high == math.inf else low


def run(physics: Physics, s: float, zeta: float, steps: int) -> NDArray[np.float64]:
    """Stretch ``(steps + 1,)`` of a spring with omega h = s, as the program moves it.

    A spring of rest length 0 from a fixed node, thrown by `THROW` a step from where the two coincide: along one line
    such a spring is linear however far it swings. `explicit` linearises about the built shape, where this spring has no
    direction, and so does not refuse the step: what is measured is its kernel and not its guard.
    """
    h = physics.dt
    body = Body.from_arrays(
        [(0, 0), (0, 0)], [(0, 1)], stiffness=(s / h) ** 2, damping_ratio=zeta, rest_length=0.0,
        velocity=[(0, 0), (THROW / h, 0)], fixed=[True, False],
    )  # fmt: skip
    scene = Scene(gravity=0.0, floor=None)
    unbound = replace(physics, max_speed=None, max_strain=None, max_energy=None)
    trials = simulate(body, np.zeros((1, 0)), scene=scene, physics=unbound, duration=steps * h, record_every=1)
    assert trials.positions is not None
    return trials.positions[:, 1, 0, 0].astype(np.float64) / THROW


def measured_radius(physics: Physics, s: float, zeta: float) -> float:
    """Spectral radius of a step, read off a run of four steps.

    By Cayley and Hamilton the stretches obey ``x'' = p x' - q x`` with the trace p and the determinant q of the matrix.
    The first step is left out: the spring has no direction where it starts. Infinite if the run leaves all bounds.
    """
    x = run(physics, s, zeta, 4)[1:]
    if not np.isfinite(x).all():
        return math.inf
    past = np.stack([x[1:-1], -x[:-2]], axis=1)
    # Each equation by its own size: after a few steps of a stiff, damped spring hardly anything is left.
    size = np.maximum(np.abs(past).max(axis=1), np.finfo(float).tiny)
    trace, determinant = np.linalg.solve(past / size[:, None], x[2:] / size)
    return float(np.abs(np.roots([1.0, -trace, determinant])).max())


def run_across(physics: Physics, s: float, steps: int) -> NDArray[np.float64]:
    """Swing ``(steps + 1,)`` of a node across two undamped springs, strained by `STRAIN` and held at their far ends."""
    k = (s / physics.dt) ** 2 / (2.0 * STRAIN)
    body = Body.from_arrays(
        [(-1, 0), (0, SWING), (1, 0)], [(0, 1), (1, 2)], stiffness=k, damping_ratio=0.0, rest_length=1.0 - STRAIN,
        fixed=[True, False, True],
    )  # fmt: skip
    scene, seconds = Scene(gravity=0.0, floor=None), steps * physics.dt
    trials = simulate(body, np.zeros((1, 0)), scene=scene, physics=physics, duration=seconds, record_every=1)
    assert trials.positions is not None
    return trials.positions[:, 1, 1, 0].astype(np.float64)


def curves(theta: float, points: int = 400) -> pd.DataFrame:
    """Spectral radii by theory: one row an integrator, zeta and omega h."""
    return pd.DataFrame(
        [
            {"integrator": name, "zeta": zeta, "omega_h": s, "radius": spectral_radius(name, s, zeta, theta)}
            for name in INTEGRATORS
            for zeta in ZETAS
            for s in np.geomspace(LEAST, MOST, points)
        ]
    )


def ladder(theta: float) -> pd.DataFrame:
    """Spectral radii by theory and as measured on the rungs of `LADDER`."""
    rows = []
    for name in INTEGRATORS:
        physics = _physics(name, theta)
        for zeta in ZETAS:
            for s in LADDER:
                theory, measured = spectral_radius(name, s, zeta, theta), measured_radius(physics, s, zeta)
                rows.append({"integrator": name, "zeta": zeta, "omega_h": s, "theory": theory, "measured": measured})
    return pd.DataFrame(rows)


def limits(theta: float) -> pd.DataFrame:
    """Limits of omega h by theory and as measured: along a spring, and across taut ones (zeta is NaN).

    Infinite: none up to `MOST`.
    """
    rows = []
    for name in INTEGRATORS:
        physics = _physics(name, theta)
        rows += [(name, zeta, theory_limit(name, zeta, theta), measured_limit(physics, zeta)) for zeta in ZETAS]
        rows.append((name, math.nan, theory_limit_across(name), measured_limit_across(physics)))
    return pd.DataFrame(rows, columns=["integrator", "zeta", "theory", "measured"])


def _physics(integrator: str, theta: float) -> Physics:
    """Double precision, and bounds that a spring at the largest omega h does not meet."""
    return Physics(integrator=integrator, dt=STEP, precision="float64", theta=theta, max_speed=1e30, refinements=0)
