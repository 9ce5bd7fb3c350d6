"""Solutions by other means: SciPy's integrators, the matrix exponential, closed forms."""

from __future__ import annotations

import numpy as np
from reference.law import contact_damping_ratio, contact_stiffness, damping, inverse_masses, rest_lengths
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
    k = contact_stiffness(body, slice(None), floor)
    dashpot = 2 * contact_damping_ratio(floor.restitution) * np.sqrt(k * np.asarray(body.mass))
    force = np.maximum(0.0, -k * x[:, 1] - dashpot * v[:, 1])
    return np.where(x[:, 1] < 0, force, 0.0)


def linearised(body) -> np.ndarray:
    """Matrix A of the small motions ``(x, v)' = A (x, v)`` about the shape in which all springs are at rest length.

    All nodes must be free. Shape (4 nodes, 4 nodes): displacements of all nodes (x0, y0, x1, ...), then velocities.
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
    return np.block([[np.zeros((n, n)), np.eye(n)], [-inverse * stiffness, -inverse * dashpots]])


def small_motion(body, displacement: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Displacements (times, nodes, 2) by matrix exponentials, from rest at `displacement` (nodes, 2)."""
    system = linearised(body)
    start = np.concatenate([displacement.ravel(), np.zeros(displacement.size)])
    return np.stack([(expm(t * system) @ start)[: displacement.size].reshape(-1, 2) for t in times])


def longest_rk4_step(rates: np.ndarray) -> float:
    """Longest step h with ``|1 + z + z^2/2 + z^3/6 + z^4/24| <= 1`` at z = h * rate of every mode (s)."""
    rates = rates[np.abs(rates) > 1e-6 * np.abs(rates).max()]  # rigid motions are 0 but for rounding

    def stable(h: float) -> bool:
        z = h * rates
        return bool(np.all(np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))) <= 1 + 1e-9))

    low, high = 0.0, 3 / np.abs(rates).max()  # beyond 3 no mode is stable
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def damped_oscillator(stretch: float, omega: float, damping_ratio: float, times: np.ndarray) -> np.ndarray:
    """Stretch (times,) of ``x'' = -omega^2 x - 2 zeta omega x'`` released at rest from `stretch`."""
    root = np.sqrt(complex(damping_ratio**2 - 1)) * omega
    decay = np.exp(-damping_ratio * omega * times)
    if root == 0:
        return stretch * decay * (1 + omega * times)
    shape = np.cosh(root * times) + damping_ratio * omega / root * np.sinh(root * times)
    return stretch * np.real(decay * shape)
