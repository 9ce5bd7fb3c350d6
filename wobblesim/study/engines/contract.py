"""What an engine is: something that computes jobs, here or elsewhere, and gives back a receipt for each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Protocol

from wobblesim.study.work import Beat, Job, Receipt


class Engine(Protocol):
    """How groups of runs are computed. An engine is entered before it is asked, and left at the end."""

    @property
    def workers(self) -> int:
        """How many jobs are computed at a time."""
        ...

    @property
    def threads(self) -> int:
        """Threads of each."""
        ...

    def __call__(
        self, jobs: Iterable[Job], heard: Callable[[Beat], None], stop: Callable[[], bool]
    ) -> Iterator[Receipt]:
        """Compute jobs, and yield what came of each as it ends, in any order.

        Parameters
        ----------
        jobs : iterable of Job
            Taken as they are needed: there may be many.
        heard : callable
            Told how far a job is, now and then.
        stop : callable
            Once it says True, no further job is begun, and those in progress end with a checkpoint.

        Raises
        ------
        WriteError
            If a worker could not write; the jobs in progress elsewhere end with a checkpoint first.
        """
        ...


OpenEngine = AbstractContextManager[Engine]
