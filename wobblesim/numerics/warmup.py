"""Compiling the kernels that a sweep will need before it starts."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from wobblesim.physics.kernels import available_threads
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import VECTOR_BYTES, advance, block_widths, simulate
from wobblesim.robot.starfish import starfish

STEP = 1e-4  # s, below the limit of every integrator; the kernels are the same for all steps
SCENES = {"floor": Scene(), "free flight": Scene(floor=None)}


@dataclass(frozen=True)
class Warmed:
    """One kernel: what it is of, whether it had to be compiled, and how long that, or loading it, took."""

    integrator: str
    precision: str
    width: int
    scene: str
    compiled: bool
    seconds: float


def warm_up(integrators: Iterable[str], precisions: Iterable[str], scenes: Iterable[str]) -> Iterator[Warmed]:
    """Compile every kernel that trials of the starfish need, or load it if it is on disk.

    Parameters
    ----------
    integrators : names of `INTEGRATORS`
    precisions : float32, float64
    scenes : names of `SCENES`

    Yields
    ------
    Warmed
        One for each combination and lane width, as it is done.
    """
    body = starfish()
    for name, precision, scene in itertools.product(integrators, precisions, scenes):
        physics = Physics(integrator=name, precision=precision, dt=STEP)
        for width in _widths(name, precision):
            behaviours = np.full((width, 2 * body.n_groups), 0.5)  # motors at rest might need another kernel
            misses, begun = _misses(), time.perf_counter()
            options = {"scene": SCENES[scene], "physics": physics, "duration": STEP}
            simulate(body, behaviours, threads=1, width=width, **options)
            yield Warmed(name, precision, width, scene, _misses() > misses, time.perf_counter() - begun)


def _widths(integrator: str, precision: str) -> list[int]:
    """Every lane width that `simulate` chooses for some number of trials, widest first."""
    full = INTEGRATORS[integrator].registers * VECTOR_BYTES // np.dtype(precision).itemsize
    threads = available_threads()
    numbers = range(1, full * threads + 1)
    return sorted({width for number in numbers for width in block_widths(number, threads, full)}, reverse=True)


def _misses() -> int:
    """Kernels that this process has asked for in vain on disk."""
    return sum(advance.stats.cache_misses.values())
