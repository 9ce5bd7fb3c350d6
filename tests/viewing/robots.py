"""Recordings for tests of what shows them, without a sweep."""

from __future__ import annotations

import math

import numpy as np

import wobblesim as ws
from wobblesim.viewing.recording import Recording


def recorded(body=None, *, condition="fixed", seed=0, duration=4.0, amplitude=1.0, **changes):
    """A trial of a random behaviour, all frames of it; `changes` to the recording."""
    body = body or ws.starfish(arms=3, sections=2)
    behaviour = np.random.default_rng(seed).random(2 * body.n_groups)
    behaviour[: body.n_groups] *= amplitude
    trials = ws.simulate(body, [behaviour], duration=duration, record_every=2)
    performance = float(trials.displacement[0])
    told = {
        "condition": condition,
        "seed": seed,
        "epoch": 7,
        "behaviour": behaviour,
        "morphology": ws.Morphology(),
        "body": body,
        "floor": 0.0,
        "duration": duration,
        "times": 0.04 * np.arange(len(trials.positions)),
        "positions": trials.positions[..., 0].astype(np.float64),
        "performance": performance,
        "stored": performance,
        "status": "ok",
        "dt": 0.02,
        "bound": "",
        "diverged_at": math.nan,
    }
    return Recording(**(told | changes))


def stretched(*contractions, length=400.0):
    """One muscle 100 u above the floor, shorter than at rest by one of these parts of its length in each frame."""
    body = ws.Body.from_arrays([[0.0, 100.0], [length, 100.0]], [[0, 1]], muscles=[(0, 0, 1.0)], center=[0])
    right = length * (1.0 - np.array(contractions))
    positions = np.zeros((len(right), 2, 2))
    positions[:, :, 1] = 100.0
    positions[:, 1, 0] = right
    times = 0.5 * np.arange(len(right))
    return recorded(body, duration=0.04, times=times, positions=positions)
