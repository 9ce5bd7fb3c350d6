"""What a simulated second of one lane costs, for many settings side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wobblesim.numerics.reference import full_width
from wobblesim.numerics.scenes import Case
from wobblesim.physics.scene import Physics
from wobblesim.physics.simulate import simulate

LANES = 64
"""Lanes of a timed run: whole blocks for every integrator and precision."""

SMALL = 30
"""A body of fewer nodes is timed on 16 times as many lanes, since a run of it is over before the clock has moved."""

LEAST_STEPS = 500
"""Of a timed run of such a body."""

Setting = tuple[Physics, int | None]
"""A setting and its lanes a block: None for a full one."""


def seconds_per_second(case: Case, settings: Sequence[Setting], *, repeats: int, most: int) -> dict[Setting, float]:
    """Run time of a simulated second of one lane, on one thread, s.

    The kernels are compiled first. Every run is timed beside a run of a single step, which is taken off: it costs
    what a call costs before its first step. All settings are timed once, then all again, so that a slow spell of the
    machine hits all alike; of the repeats the shortest counts. `most` bounds the steps of one robot in a run.
    Settings that differ in theta only do the same work, and are timed as one.
    """
    work = {setting: (replace(setting[0], theta=Physics().theta), setting[1]) for setting in settings}
    steps = {setting: _steps(case, setting[0], most) for setting in work.values()}
    least = dict.fromkeys(steps, (np.inf, np.inf))
    for setting in steps:
        _time(case, setting, 1)
    for _ in range(repeats):
        for setting, n_steps in steps.items():
            found = _time(case, setting, n_steps), _time(case, setting, 1)
            least[setting] = (min(least[setting][0], found[0]), min(least[setting][1], found[1]))
    return {s: _rate(case, alike[0], *least[alike], steps[alike]) for s, alike in work.items()}


def _rate(case: Case, physics: Physics, whole: float, one_step: float, n_steps: int) -> float:
    took = whole - one_step
    return took / ((n_steps - 1) * physics.dt * _lanes(case)) if took > 0 else np.nan


def _lanes(case: Case) -> int:
    return LANES * (16 if case.body.n_nodes < SMALL else 1)


def _steps(case: Case, physics: Physics, most: int) -> int:
    wanted = round(case.duration / physics.dt)
    return max(2, min(wanted, most // LANES)) if case.body.n_nodes >= SMALL else max(LEAST_STEPS, wanted)


def _time(case: Case, setting: Setting, n_steps: int) -> float:
    physics, width = setting
    behaviours = np.resize(case.behaviours, (_lanes(case), case.behaviours.shape[1]))
    start = time.perf_counter()
    simulate(
        case.body, behaviours, morphology=case.morphology, scene=case.scene, physics=physics, gait=case.gait,
        duration=n_steps * physics.dt, record_every=n_steps, threads=1, width=width or full_width(physics),
    )  # fmt: skip
    return time.perf_counter() - start
