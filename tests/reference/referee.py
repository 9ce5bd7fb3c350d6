"""Runs the twin of an integrator on what `wobblesim.simulate` was given, and measures how far apart they are."""

from __future__ import annotations

import numpy as np
from reference import explicit_twin, impulse_twin, midpoint_twin
from reference.law import Trajectory

import wobblesim as ws

TWINS = {
    "impulse": lambda physics: (impulse_twin.simulate_one, {"iterations": physics.iterations}),
    "midpoint": lambda physics: (midpoint_twin.simulate_one, {"theta": physics.theta}),
    "explicit": lambda physics: (explicit_twin.simulate_one, {}),
}


def referee(body, behaviour, *, scene, physics, gait, steps) -> Trajectory:
    """The twin's trajectory of one behaviour."""
    simulate_one, options = TWINS[physics.integrator](physics)
    gravity = scene.gravity if np.ndim(scene.gravity) else (0.0, -scene.gravity)
    return simulate_one(
        body, behaviour, gravity=gravity, floor=scene.floor, gait=gait, dt=physics.dt, steps=steps, **options
    )


def compare(body, behaviours, *, scene, physics, gait=None, steps=100, lanes=None) -> tuple[ws.Trials, float]:
    """Trials of the program, and the largest distance in u of any node at any step from the twin's.

    `lanes` chooses the behaviours that the (slow) twin repeats; all by default.
    """
    gait = gait or ws.Gait(period=0.3, max_amplitude=0.2)
    trials = ws.simulate(
        body, behaviours, scene=scene, physics=physics, gait=gait, duration=steps * physics.dt, record_every=1
    )
    gaps = []
    for lane in range(len(behaviours)) if lanes is None else lanes:
        twin = referee(body, behaviours[lane], scene=scene, physics=physics, gait=gait, steps=steps)
        gaps.append(np.abs(trials.positions[:, :, :, lane] - np.array(twin.positions)).max())
        if physics.integrator == "impulse" and physics.precision == "float64":
            assert trials.limited[lane] == twin.limited
    return trials, float(max(gaps))
