"""Where a sweep stands, for whoever wants to show it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from wobblesim.study.plan import Group
from wobblesim.study.work import Beat, Receipt

Kind = Literal["begin", "epoch", "run", "failure", "note", "end"]


@dataclass(frozen=True)
class Progress:
    """Where a sweep stands, as told after every epoch, run and trouble.

    Attributes
    ----------
    kind : {"begin", "epoch", "run", "failure", "note", "end"}
    wanted, present, done, failed : int
        Runs: asked for; there before this command; computed by it; come to nothing.
    diverged, refined : int
        Trials under this command that diverged, or would have without a smaller step.
    group : str
        The runs in progress, in words.
    epoch, epochs : int
        Epochs done and wanted of the group in progress.
    fraction : float
        Part of the missing work that is done, 0 to 1.
    remaining : float or None
        Estimated wall time to the end, s; None while nothing is known.
    message : str
        One sentence, for "run", "failure" and "note".
    """

    kind: Kind
    wanted: int
    present: int
    done: int
    failed: int
    diverged: int
    refined: int
    group: str
    epoch: int
    epochs: int
    fraction: float
    remaining: float | None
    message: str


TOLD = ("wanted", "present", "done", "failed", "diverged", "refined", "group", "epoch", "epochs")
"""What a progress says as the meter has it."""


class Meter:
    """Counts a sweep's runs and lane-steps, and tells of them.

    Parameters
    ----------
    tell : callable
        Called with each `Progress`.
    wanted, present, failed : int
        Runs asked for, there already, and of the latter those that failed.
    work : int
        Lane-steps of the missing runs, at most.
    """

    def __init__(self, tell: Callable[[Progress], None], wanted: int, present: int, failed: int, work: int) -> None:
        self._tell, self.wanted, self.present, self.failed, self.work = tell, wanted, present, failed, work
        self.done = self.diverged = self.refined = self.epoch = self.epochs = 0
        self.group = ""
        self._busy: set[Group] = set()
        self._worked = 0
        self._first: tuple[float, int] | None = None

    def tell(self, kind: Kind, message: str = "") -> None:
        """Say where the sweep stands."""
        fraction = min(1.0, self._worked / self.work) if self.work else 1.0
        mine = {name: getattr(self, name) for name in TOLD}
        self._tell(Progress(kind, **mine, fraction=fraction, remaining=self._remaining(), message=message))

    def hear(self, beat: Beat) -> None:
        """Count what a job has done since it was last heard of."""
        self._busy.add(beat.group)
        others = f" and {len(self._busy) - 1} more" if len(self._busy) > 1 else ""
        self.group, self.epoch, self.epochs = f"{beat.group}{others}", beat.epoch, beat.epochs
        self.work -= beat.skipped
        self._worked += beat.work
        self.diverged += beat.diverged
        self.refined += beat.refined
        if beat.work and self._first is None:
            # The first epoch may contain the compilation of the kernels: the rate is measured from its end.
            self._first = time.monotonic(), self._worked
        if beat.work:
            self.tell("epoch")

    def finish(self, receipt: Receipt) -> None:
        """Count the runs that were stored of a job."""
        self._busy.discard(receipt.job.group)
        for line, said in zip(receipt.lines, receipt.said, strict=True):
            self.done += 1
            self.failed += line["status"] == "failed"
            self.tell("run", said)

    def fail(self, receipt: Receipt, left: int) -> None:
        """Count the runs of a job that came to nothing, whose last `left` lane-steps need not be done."""
        group = receipt.job.group
        self._busy.discard(group)
        self.work -= left
        self.failed += len(receipt.job.missing)
        self.tell("failure", f"{group}: failed in epoch {receipt.epoch}: {_last_line(receipt.error)}")

    def _remaining(self) -> float | None:
        if self._first is None:
            return None
        since, before = self._first
        worked = self._worked - before
        return (time.monotonic() - since) / worked * max(0, self.work - self._worked) if worked else None


def _last_line(traceback: str) -> str:
    """What was raised, and its message, in one line."""
    lines = traceback.strip().splitlines()
    start = max((place for place, line in enumerate(lines) if line.startswith("  ")), default=-1) + 1
    return " ".join(" ".join(lines[start:]).split())
