"""A grain that falls on the compliant floor, by its closed forms: parabolas between contacts, damped swings in them."""

from __future__ import annotations

import numpy as np
from reference.law import contact_damping_ratio
from scipy.optimize import brentq


def bounce(height: float, gravity: float, restitution: float, stiffness: float, duration: float) -> tuple[float, int]:
    """Height in u after `duration` s, and the number of contacts, of a grain let fall from `height` above the floor.

    `stiffness` is per unit of mass, 1/s2. A contact begins at the surface and ends when its force falls to zero.
    """
    time, y, v, contacts = 0.0, height, 0.0, 0
    while True:
        impact = np.sqrt(v * v + 2 * gravity * y)
        left = duration - time
        if left <= (v + impact) / gravity:
            return y + v * left - gravity * left**2 / 2, contacts
        time, contacts = time + (v + impact) / gravity, contacts + 1
        state, force, longest = _contact(-impact, gravity, restitution, stiffness)
        samples = np.linspace(1e-9, longest, 1000)
        pulls = np.flatnonzero([force(t) < 0 for t in samples])
        end = brentq(force, samples[pulls[0] - 1], samples[pulls[0]], xtol=1e-15) if len(pulls) else np.inf
        if time + end >= duration:
            return state(duration - time)[0], contacts
        time, (y, v) = time + end, state(end)


def _contact(speed, gravity, restitution, stiffness):
    """State and force over time after the touch-down at `speed` (< 0), and a swing's whole period."""
    omega, ratio = np.sqrt(stiffness), contact_damping_ratio(restitution)
    swing, decay, rest = omega * np.sqrt(1 - ratio**2), omega * ratio, -gravity / stiffness
    cosine, sine = -rest, (speed - decay * rest) / swing

    def state(t):
        c, s, fade = np.cos(swing * t), np.sin(swing * t), np.exp(-decay * t)
        y = fade * (cosine * c + sine * s)
        return y + rest, fade * swing * (sine * c - cosine * s) - decay * y

    def force(t):
        y, v = state(t)
        return -stiffness * y - 2 * decay * v

    return state, force, 2 * np.pi / swing
