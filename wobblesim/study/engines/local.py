"""The engine of one process: a group after the other, each on all threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from wobblesim.physics.simulate import Trials, simulate
from wobblesim.study.work import Beat, Job, Receipt, compute


@dataclass(frozen=True)
class Local:
    """Computes jobs in this process.

    Parameters
    ----------
    threads : int
        Of each call of the simulator.
    simulate : callable
        Called as `wobblesim.simulate` is; another one makes another task of it.
    """

    threads: int
    simulate: Callable[..., Trials] = simulate
    workers: int = 1

    def __call__(
        self, jobs: Iterable[Job], heard: Callable[[Beat], None], stop: Callable[[], bool]
    ) -> Iterator[Receipt]:
        """Compute jobs one by one."""
        for job in jobs:
            if stop():
                return
            yield compute(job, heard, stop, self.threads, self.simulate)


@contextmanager
def local(threads: int, simulate: Callable[..., Trials] = simulate) -> Iterator[Local]:
    """Open the engine of one process."""
    yield Local(threads, simulate)
