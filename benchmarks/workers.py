"""What worker processes cost: the efficiency of 1, 2 and 4 of them, and the overhead of many tiny runs.

python benchmarks/workers.py [efficiency | overhead]

Efficiency: the same study of real robots, about a minute each, on all cores: in this process, and on 1, 2 and 4 workers
that share the cores. With fewer cores than workers the cores are oversubscribed; nothing is gained then. Overhead: 10^4
runs of a task that takes no time; what is left of the wall time when the learner's own is taken off is the store's and
the scheduler's. Kernels warm; the start of the workers is told apart.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from wobblesim.config import SweepConfig, load_config, parse_config
from wobblesim.learning.run import Learner
from wobblesim.numerics.throughput import conditions
from wobblesim.physics.kernels import available_threads
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.study.engines.cluster import cluster
from wobblesim.study.engines.local import local
from wobblesim.study.execute import sweep
from wobblesim.study.plan import lane_steps, setup, study

ROBOTS = (
    "name=workers",
    "trial.duration=10",
    "learning.epochs=400",
    "wobble={dimension: mass, amplitude: 0.5, period: 25, end: 200}",
    "conditions={fixed: {wobble: null}, wobbling: {}}",
)
SEEDS = "0..31"

AMPLITUDES = ", ".join(f"{0.001 * (1 + number):.3f}" for number in range(100))

TINY = f"""
name: tiny
seeds: 0..99
robot: {{kind: starfish, arms: 3, sections: 2}}
learning: {{epochs: 2}}
wobble: {{dimension: mass, amplitude: 0.1, period: 5, end: 1}}
sweep: {{wobble.amplitude: [{AMPLITUDES}]}}
"""


def task(body: Any, behaviours: np.ndarray, **_: Any) -> Trials:
    """An outcome that takes no time."""
    n = len(behaviours)
    return Trials(
        displacement=behaviours[:, 0],
        status=np.full(n, "ok"),
        dt=np.full(n, 0.02),
        bound=np.full(n, ""),
        limited=np.zeros(n, dtype=np.int64),
        diverged_at=np.full(n, np.nan),
        inverted=np.zeros(n, dtype=np.int64),
        positions=None,
    )


def timed(config: SweepConfig, workers: int, of: Callable[..., Trials]) -> tuple[float, float]:
    """Seconds to start so many workers (0: none, all in this process), and to compute a study."""
    cores = available_threads()
    begun = time.perf_counter()
    opened = cluster(workers, max(1, cores // workers), simulate=of) if workers else local(cores, of)
    with tempfile.TemporaryDirectory() as folder, opened as engine:
        started = time.perf_counter()
        outcome = sweep(config, Path(folder), engine=nullcontext(engine))
        assert outcome.failed == 0
        return started - begun, time.perf_counter() - started


def efficiency() -> None:
    """Print seconds, throughput and efficiency of each engine."""
    config = load_config("configs/quickstart.yaml", ROBOTS, SEEDS)
    laid_out = study(config)
    work = sum(len(config.seeds) * lane_steps(made) for made in laid_out.setups.values())
    timed(load_config("configs/quickstart.yaml", (*ROBOTS, "learning.epochs=2", "wobble.end=1"), SEEDS), 0, simulate)
    print(f"{work:.2e} lane-steps at most, {laid_out.n_runs} runs, {available_threads()} cores\n")
    print("engine     threads  start s  sweep s  M lane-steps/s  of local")
    reference = None
    for workers in (0, 1, 2, 4):
        start, seconds = timed(config, workers, simulate)
        reference = reference or seconds
        name = f"{workers} worker{'s' if workers > 1 else ' '}" if workers else "local    "
        threads = max(1, available_threads() // (workers or 1))
        print(
            f"{name:10s} {threads:7d} {start:8.1f} {seconds:8.1f} {work / seconds / 1e6:15.2f} "
            f"{reference / seconds:9.0%}"
        )


def overhead() -> None:
    """Print what a tiny run costs besides the learner."""
    config = parse_config(TINY)
    laid_out = study(config)
    begun = time.perf_counter()
    for parameters in laid_out.conditions.values():
        made = setup(parameters)
        for start in range(0, len(config.seeds), 16):
            learner = Learner(made, config.seeds[start : start + 16], 1, simulate=task)
            while not learner.done:
                learner.advance()
    learning = time.perf_counter() - begun
    runs = laid_out.n_runs
    print(f"\n{runs} runs; the learner alone takes {1e3 * learning / runs:.2f} ms a run\n")
    print("engine     start s  sweep s  ms a run  ms overhead a run")
    for workers in (0, 1, 2):
        start, seconds = timed(config, workers, task)
        name = f"{workers} worker{'s' if workers > 1 else ' '}" if workers else "local    "
        rest = seconds - learning / (workers or 1)
        print(f"{name:10s} {start:7.1f} {seconds:8.1f} {1e3 * seconds / runs:9.2f} {1e3 * rest / runs:18.2f}")


def main() -> None:
    """Print both tables, or the one asked for."""
    print(", ".join(f"{name} {value}" for name, value in conditions().items()))
    for part in (efficiency, overhead):
        if part.__name__ in (sys.argv[1:] or ["efficiency", "overhead"]):
            part()


if __name__ == "__main__":
    main()
