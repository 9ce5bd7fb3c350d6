"""How fast each integrator moves robots: lane-steps (one robot, one step) per second."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from llvmlite import binding

from wobblesim.physics.kernels import available_threads
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import simulate
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.starfish import starfish
from wobblesim.study.provenance import cpu

# A full run of the paper: epochs x behaviours x seconds.
FULL_RUN_SECONDS = 4000 * 20 * 60.0
# Steps at which the integrators are compared: the author's, a coarse one, and one within the explicit limit (4.1e-4 s).
STEPS = {"impulse": 0.005, "midpoint": 0.02, "explicit": 0.0002}


@dataclass(frozen=True)
class Throughput:
    """One row of the table; rates in lane-steps per second."""

    integrator: str
    precision: str
    dt: float
    width: int
    one_thread: float
    all_threads: float
    threads: int
    scalar: float

    @property
    def speed_up(self) -> float:
        """All threads over one."""
        return self.all_threads / self.one_thread

    @property
    def vector_gain(self) -> float:
        """One thread over the scalar twin: the same source, one lane."""
        return self.one_thread / self.scalar

    @property
    def full_run(self) -> float:
        """Projected time of a full run on all threads, s."""
        return FULL_RUN_SECONDS / self.dt / self.all_threads


def measure(
    integrators: tuple[str, ...] | None = None,
    precisions: tuple[str, ...] = ("float32", "float64"),
    *,
    seconds: float = 0.5,
    repeats: int = 5,
    threads: int | None = None,
) -> Iterator[Throughput]:
    """Time the starfish on the floor under random behaviours, contacts active.

    Kernels are compiled before anything is timed. Each figure is the best of `repeats` runs of about `seconds`:
    whatever else the machine does can only slow a run down.

    Parameters
    ----------
    integrators : tuple of str, optional
        Names of `INTEGRATORS`; all if not given.
    precisions : tuple of str
    seconds, repeats : float, int
    threads : int, optional
        What "all threads" means; all that Numba may use if not given.
    """
    threads = threads or available_threads()
    body = starfish()
    for name in integrators or tuple(INTEGRATORS):
        for precision in precisions:
            width = INTEGRATORS[name].registers * 64 // np.dtype(precision).itemsize
            physics = Physics(integrator=name, dt=STEPS[name], precision=precision)
            one, every, scalar = (
                _rate(body, physics, width=w, lanes=w * t * blocks, threads=t, seconds=seconds, repeats=repeats)
                for w, t, blocks in ((width, 1, 2), (width, threads, 2), (1, 1, 1))
            )
            yield Throughput(name, precision, physics.dt, width, one, every, threads, scalar)


def _rate(body: Body, physics: Physics, *, width: int, lanes: int, threads: int, seconds: float, repeats: int) -> float:
    behaviours = np.random.default_rng(0).random((lanes, 2 * body.n_groups))

    def run(n_steps: int) -> float:
        return _time(
            lambda: simulate(
                body,
                behaviours,
                scene=Scene(),
                physics=physics,
                gait=Gait(),
                duration=n_steps * physics.dt,
                threads=threads,
                width=width,
            )
        )

    run(10)
    n_steps = max(100, int(seconds / run(100) * 100))
    return lanes * n_steps / min(run(n_steps) for _ in range(repeats))


def _time(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def conditions() -> dict[str, str]:
    """The machine and the versions that a figure was measured with."""
    return {
        "cpu": f"{cpu()} ({binding.get_host_cpu_name()})",
        "cores": str(available_threads()),
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numba", "llvmlite", "numpy")},
    }
