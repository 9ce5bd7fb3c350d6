"""What a dask worker does: it computes one job, tells of it now and then, and asks whether to go on."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from distributed import get_worker

from wobblesim.physics.simulate import Trials
from wobblesim.study.errors import StoreError
from wobblesim.study.work import Beat, Job, Receipt, compute

TELL_EVERY = 1.0
"""s between two messages of a job."""

SIGHT_PATIENCE = 30.0
"""s for a folder that was just made to be seen on another machine: network file systems remember what was not there."""

SUMMED = ("work", "skipped", "diverged", "refined")

STOPPED: set[str] = set()
"""Topics of the sweeps that were stopped while this process lived."""


class Abandoned(Exception):  # noqa: N818 - nobody hears of it
    """Nobody waits for this job any more: another worker may have it by now."""


def compute_here(job: Job, topic: str, threads: int, simulate: Callable[..., Trials]) -> tuple[Receipt, dict[str, Any]]:
    """Compute a job in a thread of a dask worker.

    Parameters
    ----------
    job : Job
    topic : str
        Under which to tell how far it is.
    threads : int
        Of each call of the simulator.
    simulate : callable

    Returns
    -------
    receipt : Receipt
    told : dict
        The last message: what the whole job came to.
    """
    teller = _Teller(topic)
    _wait_for(job.scratch)
    return compute(job, teller.heard, teller.stop, threads, simulate), teller.message


def stop_here(topic: str) -> None:
    """Let the jobs of a sweep in this process end after the epoch in progress, with a checkpoint."""
    STOPPED.add(topic)


class _Teller:
    """Sums up the beats of a job, and sends the sums."""

    def __init__(self, topic: str) -> None:
        self._worker, self._topic = get_worker(), topic
        self._sent, self._last = 0, 0.0
        self.message: dict[str, Any] = {"key": self._worker.get_current_task(), "epoch": 0, "epochs": 0}
        self.message |= dict.fromkeys(SUMMED, 0)

    def heard(self, beat: Beat) -> None:
        """Take in a beat; send the sums if the last ones are a while ago.

        The first two are sent at once: the job has begun, and its kernels are compiled.
        """
        self._give_up_if_abandoned()
        self.message |= {"epoch": beat.epoch, "epochs": beat.epochs}
        for name in SUMMED:
            self.message[name] += int(getattr(beat, name))
        if self._sent < 2 or time.monotonic() - self._last >= TELL_EVERY:
            self._worker.log_event(self._topic, dict(self.message))
            self._sent, self._last = self._sent + 1, time.monotonic()

    def stop(self) -> bool:
        """Whether the sweep was stopped."""
        self._give_up_if_abandoned()
        return self._topic in STOPPED

    def _give_up_if_abandoned(self) -> None:
        """Leave, if the scheduler has let go of this worker or of the job: a checkpoint now would be a second one."""
        task = self._worker.state.tasks.get(self.message["key"])
        if task is None or task.state == "cancelled" or self._worker.status.name in ("closing", "closed", "failed"):
            raise Abandoned


def _wait_for(folder: Path) -> None:
    deadline = time.monotonic() + SIGHT_PATIENCE
    while not folder.is_dir():
        if time.monotonic() > deadline:
            raise StoreError(
                f"the worker on {socket.gethostname()} does not see {folder}; "
                "give --out a folder on a file system that all workers share"
            )
        time.sleep(0.2)
