"""Physical quantities of recorded motions, computed here and not by the program under test."""

from __future__ import annotations

import numpy as np


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Plane cross product of vectors along the last axis."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def backward_velocities(x: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
    """Velocities of a method that moves by ``x' = x + h v'`` (impulse); exact."""
    return np.concatenate([start[None], np.diff(x, axis=0) / dt])


def averaged_velocities(x: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
    """Velocities of a method that moves by ``x' = x + h (v + v')/2`` (midpoint); exact."""
    velocities = [start]
    for move in np.diff(x, axis=0):
        velocities.append(2 * move / dt - velocities[-1])
    return np.array(velocities)


def differentiated_velocities(x: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
    """Velocities by central differences of order 8; the first and last four frames are NaN, the first is given."""
    weights = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    velocities = np.full_like(x, np.nan)
    velocities[4:-4] = sum(w * x[i : len(x) - 8 + i] for i, w in enumerate(weights)) / dt
    velocities[0] = start
    return velocities


VELOCITIES = {"impulse": backward_velocities, "midpoint": averaged_velocities}


def velocities(integrator: str, x: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
    """Velocities (frames, ...) from positions recorded every step: the method's own where its rule is known."""
    return VELOCITIES.get(integrator, differentiated_velocities)(x, start, dt)


def spring_energy(body, x: np.ndarray) -> np.ndarray:
    """Elastic energy (frames,) of passive springs at positions `x` (frames, nodes, 2)."""
    a, b = body.springs.T
    stretch = np.linalg.norm(x[:, b] - x[:, a], axis=-1) - body.rest_length
    return 0.5 * np.sum(body.stiffness * stretch**2, axis=-1)


def kinetic_energy(body, v: np.ndarray) -> np.ndarray:
    """Kinetic energy (frames,) of the free nodes at velocities `v` (frames, nodes, 2)."""
    return 0.5 * np.sum(np.where(body.fixed, 0.0, body.mass) * np.sum(v**2, axis=-1), axis=-1)


def angular_momentum(body, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Angular momentum (frames,) about the origin."""
    return np.sum(body.mass * cross(x, v), axis=-1)


def rk4_oscillator_velocities(x: np.ndarray, dt: float, omega: float, damping_ratio: float) -> np.ndarray:
    """Velocities (frames - 1,) that RK4 holds beside the stretches `x` of a linear oscillator.

    RK4 multiplies (x, v) by ``R(h A)``, R the exponential series to degree 4, so ``v = (x' - R_00 x) / R_01``.
    """
    generator = dt * np.array([[0, 1], [-(omega**2), -2 * damping_ratio * omega]])
    series = sum(np.linalg.matrix_power(generator, k) / [1, 1, 2, 6, 24][k] for k in range(5))
    return (x[1:] - series[0, 0] * x[:-1]) / series[0, 1]


def slope(steps: np.ndarray, errors: np.ndarray) -> float:
    """Exponent p of ``error = C dt^p`` by least squares."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
