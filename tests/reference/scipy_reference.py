"""Solutions by other means: SciPy's integrators, the matrix exponential, closed forms."""

from __future__ import annotations

import numpy as np
from reference.law import contact_damping_ratio, damping, inverse_masses, rest_lengths
from scipy.integrate import solve_ivp
from scipy.linalg import expm


def solve(body, behaviour, *, gravity, gait, times, floor=None, method="DOP853", tolerance=1e-11) -> np.ndarray:
    """States (times, 2, nodes, 2) of the smooth equations: positions in u, then velocities in u/s.

    The floor's normal force is a function of the state; its friction is not (the anchor remembers), so a body on
    a floor must have none.
    """
    if floor is not None and np.any(np.asarray(body.friction) > 0):
        raise ValueError("scipy_reference.solve: set friction to 0, a frictional floor has memory.")
    start = np.stack([body.position, np.where(np.asarray(body.fixed)[:, None], 0.0, body.velocity)])
    a, b = np.asarray(body.springs).reshape(-1, 2).T
    dashpots, inverse = damping(body), inverse_masses(body)[:, None]

    def slope(time, flat):
        x, v = flat.reshape(start.shape)
        apart = x[b] - x[a]
        distance = np.hypot(*apart.T)
        unit = apart / distance[:, None]
        closing = np.sum(unit * (v[b] - v[a]), axis=1)
        pull = body.stiffness * (distance - rest_lengths(body, behaviour, gait, time)) + dashpots * closing
        force = np.zeros_like(x)
        np.add.at(force, a, pull[:, None] * unit)
        np.add.at(force, b, -pull[:, None] * unit)
        if floor is not None:
            force[:, 1] += normal_forces(body, x, v, floor)
        pulled = np.where(inverse > 0, np.asarray(gravity, dtype=float), 0.0)
        return np.stack([v, force * inverse + pulled]).ravel()

    solution = solve_ivp(slope, (times[0], times[-1]), start.ravel(), method, times, rtol=tolerance, atol=tolerance)
    return solution.y.T.reshape(-1, *start.shape)


def normal_forces(body, x, v, floor) -> np.ndarray:
    """Compliant floor force on each node (nodes,)."""
    dashpot = 2 * contact_damping_ratio(floor.restitution) * np.sqrt(floor.stiffness * np.asarray(body.mass))
    force = np.maximum(0.0, -floor.stiffness * x[:, 1] - dashpot * v[:, 1])
    return np.where(x[:, 1] < 0, force, 0.0)


def small_motion(body, displacement: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Displacements (times, nodes, 2) of the springs linearised about the rest shape, by matrix exponentials.

    The body's springs must be at rest length and its nodes free and at rest; `displacement` (nodes, 2) is the start.
    """
    n = 2 * len(body.mass)
    stiffness, dashpots = np.zeros((n, n)), np.zeros((n, n))
    for (a, b), k, c in zip(body.springs, body.stiffness, damping(body), strict=True):
        unit = (body.position[b] - body.position[a]) / np.hypot(*(body.position[b] - body.position[a]))
        across = np.zeros(n)
        across[2 * a : 2 * a + 2], across[2 * b : 2 * b + 2] = -unit, unit
        stiffness += k * np.outer(across, across)
        dashpots += c * np.outer(across, across)
    inverse = np.repeat(inverse_masses(body), 2)[:, None]
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse * stiffness, -inverse * dashpots]])
    start = np.concatenate([displacement.ravel(), np.zeros(n)])
    return np.stack([(expm(t * system) @ start)[:n].reshape(-1, 2) for t in times])


def damped_oscillator(stretch: float, omega: float, damping_ratio: float, times: np.ndarray) -> np.ndarray:
    """Stretch (times,) of ``x'' = -omega^2 x - 2 zeta omega x'`` released at rest from `stretch`."""
    root = np.sqrt(complex(damping_ratio**2 - 1)) * omega
    decay = np.exp(-damping_ratio * omega * times)
    if root == 0:
        return stretch * decay * (1 + omega * times)
    shape = np.cosh(root * times) + damping_ratio * omega / root * np.sinh(root * times)
    return stretch * np.real(decay * shape)
