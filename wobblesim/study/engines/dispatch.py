"""Jobs on the workers of a dask scheduler: one a worker at a time, again where a worker was lost.

Each job is sent to a worker by name. Dask's own scheduling would try the jobs of a lost worker elsewhere without
telling, and give up one that was robbed of its worker three times in a week like one that kills it in one place.
"""

from __future__ import annotations

import queue
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

from distributed import Client, Future
from distributed.scheduler import KilledWorker

from wobblesim.physics.simulate import Trials
from wobblesim.study.engines.worker import Abandoned, compute_here, stop_here
from wobblesim.study.errors import StoreError, first_line
from wobblesim.study.work import Beat, Job, Receipt

TICK = 0.2
"""s between two questions whether to stop."""

LOOK_EVERY = 0.5
"""s between two looks at which workers there are."""

LOSSES = 3
"""So many workers may a job cost without its checkpoint getting any further."""

GATHER_PATIENCE = 5.0
"""s for a receipt to come over."""

LONE_PATIENCE = 60.0
"""s without any worker, after which workers of this machine are given up."""

STOP_PATIENCE = 600.0
"""s without a sign of any job, after which stopped ones are given up: an epoch of a big robot takes its time."""


GONE = "the scheduler is gone; what is stored is safe, and the same command goes on"


def threads_of(client: Client) -> dict[str, int]:
    """The workers there are, by address, and the threads that each was started with."""
    found: Any = client.nthreads()
    return found


def host_of(worker: str) -> str:
    """The host of an address such as ``tls://10.0.0.7:41234``."""
    return worker.rpartition("/")[2].rpartition(":")[0]


@dataclass
class Effort:
    """A job over all attempts at it.

    Attributes
    ----------
    job : Job
    epoch : int
        Last epoch heard of.
    losses : int
        Workers lost since its last checkpoint.
    hosts : set of str
        Where they were.
    """

    job: Job
    epoch: int = 0
    losses: int = 0
    hosts: set[str] = field(default_factory=set)
    _start: int | None = None
    _told: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("work", "diverged", "refined"), 0))
    _kept: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("diverged", "refined"), 0))
    _now: dict[str, Any] | None = None
    _lost: dict[str, Any] | None = None

    def beat(self, message: dict[str, Any]) -> Beat:
        """What a message, whose numbers are sums over an attempt, adds to what was heard before of the job.

        An attempt that begins at an earlier epoch than the last one had come to takes back what is done again.
        """
        skipped = message["skipped"] if self._start is None else 0
        self._start = message["skipped"] if self._start is None else self._start
        if self._now is None and self._lost is not None:
            self._go_on(self._lost, message["skipped"])
        self._now, self.epoch = message, message["epoch"]
        sums = {name: self._kept[name] + message[name] for name in self._kept}
        sums["work"] = message["skipped"] + message["work"] - self._start
        added = {name: sums[name] - self._told[name] for name in sums}
        self._told = sums
        return Beat(self.job.group, self.epoch, message["epochs"], skipped=skipped, **added)

    def _go_on(self, lost: dict[str, Any], skipped: int) -> None:
        """Begin where a lost attempt had its last checkpoint: what it told of up to there counts, about."""
        if skipped > lost["skipped"]:
            self.losses = 1
        share = min(1.0, (skipped - lost["skipped"]) / lost["work"]) if lost["work"] else 0.0
        for name in self._kept:
            self._kept[name] += round(share * lost[name])

    def lose(self, host: str) -> None:
        """Count a lost worker."""
        self.losses += 1
        self.hosts.add(host)
        self._now, self._lost = None, self._now or self._lost


@dataclass
class Flight:
    """An attempt."""

    effort: Effort
    worker: str
    future: Future


@dataclass
class Dispatch:
    """One call of the engine: jobs in, receipts out.

    Parameters
    ----------
    client : Client
    simulate : callable
    threads : int or None
        Of each worker; as many as it was started with if None.
    is_local : bool
        Whether the workers are this process's own, on this machine.
    said : callable
    jobs, heard, stop
        See `Engine`.
    """

    client: Client
    simulate: Callable[..., Trials]
    threads: int | None
    is_local: bool
    said: Callable[[str], None]
    jobs: Iterable[Job]
    heard: Callable[[Beat], None]
    stop: Callable[[], bool]

    def __post_init__(self) -> None:
        self._topic = f"wobblesim-{uuid.uuid4().hex}"
        self._inbox: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._flights: dict[str, Flight] = {}
        self._again: deque[Effort] = deque()
        self._fresh = map(Effort, self.jobs)
        self._failure: StoreError | None = None
        self._stopping, self._over, self._look = False, False, threading.Event()
        # The first epoch of the first job compiles the kernels for all workers of this machine.
        self._compiled = not self.is_local
        self._sign = self._last_seen = time.monotonic()
        self._has_said_lonely = False

    def receipts(self) -> Iterator[Receipt]:
        """Yield what came of each job as it ends.

        Raises
        ------
        WriteError, StoreError
            Of a worker, once the jobs elsewhere have ended with a checkpoint; or if the scheduler or all workers of
            this machine are gone.
        """
        with self._watched():
            while self._goes_on():
                self._listen()
                self._check_company()
                receipts = [*self._landed(), *self._lost()]
                self._launch()  # before the caller takes its time to store what has landed
                yield from receipts
        if self._failure:
            raise self._failure

    def _goes_on(self) -> bool:
        if not self._stopping and self.stop():
            self._call_in()
        return self._launch() or bool(self._flights) or self._waits()

    # --- out -------------------------------------------------------------------------------------------------------

    def _launch(self) -> bool:
        """Send a job to each worker that has none; return whether any was sent."""
        busy = {flight.worker for flight in self._flights.values()}
        launched = False
        for worker, threads in self._workers.items():
            if worker in busy:
                continue
            if self._stopping or (self._flights and not self._compiled):
                break
            if effort := self._next(worker):
                self._send(effort, worker, self.threads or threads)
                launched = True
        return launched

    def _next(self, worker: str) -> Effort | None:
        """A job for a worker: one that was lost on another host, else a fresh one.

        A host on which every worker dies is free more often than any other: it would be the end of all jobs.
        """
        hosts = {host_of(worker) for worker in self._workers} if self._again else set()
        for effort in self._again:
            if host_of(worker) not in effort.hosts or hosts <= effort.hosts:
                self._again.remove(effort)
                return effort
        return next(self._fresh, None)

    def _send(self, effort: Effort, worker: str, threads: int) -> None:
        key = f"{self._topic}-{uuid.uuid4().hex}"
        arguments = effort.job, self._topic, threads, self.simulate
        try:
            future = self.client.submit(compute_here, *arguments, key=key, pure=False, workers=[worker])
        except Exception as error:
            if self.client.status == "closed":
                raise StoreError(GONE) from error
            raise
        self._flights[key] = Flight(effort, worker, future)
        future.add_done_callback(lambda _: self._inbox.put(None))

    def _waits(self) -> bool:
        """Whether there are jobs, and no worker for them yet."""
        if not self._stopping and not self._again and (effort := next(self._fresh, None)):
            self._again.append(effort)
        return not self._stopping and bool(self._again)

    # --- back ------------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        """Wait a moment for news, and pass on what jobs tell."""
        with suppress(queue.Empty):
            self._hear(self._inbox.get(timeout=TICK))
            while True:
                self._hear(self._inbox.get_nowait())

    def _hear(self, message: dict[str, Any] | None) -> None:
        if message and (flight := self._flights.get(message["key"])):
            self._sign = time.monotonic()
            self._compiled |= message["work"] > 0
            self.heard(flight.effort.beat(message))

    def _landed(self) -> Iterator[Receipt]:
        """What came of the jobs that have ended."""
        for key, flight in list(self._flights.items()):
            if flight.future.status == "finished":
                with suppress(TimeoutError):  # lost on the way: its worker will be seen to be gone
                    receipt, told = flight.future.result(timeout=GATHER_PATIENCE)
                    self._hear(told)
                    del self._flights[key]
                    self._compiled = True
                    yield receipt
            elif flight.future.status in ("error", "cancelled"):
                yield from self._raised(key, flight)

    def _raised(self, key: str, flight: Flight) -> Iterator[Receipt]:
        """Note what kept a worker from computing a job at all."""
        try:
            flight.future.result(timeout=GATHER_PATIENCE)
        except (KilledWorker, CancelledError, Abandoned):
            yield from self._lose(key)
            return
        except StoreError as error:
            self._failure = self._failure or error
        except Exception as error:
            self._failure = self._failure or StoreError(
                f"the worker {flight.worker} cannot compute ({_root(error)}); "
                "workers and scheduler need what is installed here"
            )
        del self._flights[key]
        self._call_in()

    def _lost(self) -> Iterator[Receipt]:
        """Let go of the jobs of workers that are gone."""
        for key, flight in list(self._flights.items()):
            if flight.worker not in self._workers and not flight.future.done():
                yield from self._lose(key)

    def _lose(self, key: str) -> Iterator[Receipt]:
        flight = self._flights.pop(key)
        effort = flight.effort
        effort.lose(host_of(flight.worker))
        if effort.losses >= LOSSES:
            why = f"it killed its worker three times, the last time after epoch {effort.epoch} or later: out of memory?"
            yield Receipt(effort.job, error=why, epoch=effort.epoch)
        elif not self._stopping:
            self._again.append(effort)
            self.said(f"{effort.job.group}: its worker was lost; it goes on from its last checkpoint")

    # --- the workers -----------------------------------------------------------------------------------------------

    def _call_in(self) -> None:
        """Let the jobs in progress end with a checkpoint, and begin no other."""
        self._stopping, self._sign = True, time.monotonic()
        self._look.set()

    def _check_company(self) -> None:
        """Give up where nothing can come any more.

        Raises
        ------
        StoreError
        """
        now = time.monotonic()
        if self.client.status == "closed":
            raise StoreError(GONE)
        if self._workers:
            self._last_seen = now
        elif self.is_local and now - self._last_seen > LONE_PATIENCE:
            raise StoreError("no worker stays alive; try --engine local, which shows why")
        elif not self._has_said_lonely and now - self._last_seen > LONE_PATIENCE / 6:
            self._has_said_lonely = True
            self.said("the scheduler has no worker; waiting for one")
        if self._stopping and now - self._sign > STOP_PATIENCE:
            raise StoreError("the workers do not answer; the same command goes on from their last checkpoints")

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Know which workers there are, and hear from them."""
        self._workers = threads_of(self.client)
        self.client.subscribe_topic(self._topic, lambda event: self._inbox.put(event[1]))
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            yield
        finally:
            self._over = True
            self._look.set()
            for flight in self._flights.values():
                flight.future.release()
            with suppress(Exception):  # there is no scheduler any more
                self.client.unsubscribe_topic(self._topic)

    def _watch(self) -> None:
        """Ask the scheduler in a thread of its own, which may hang when it does."""
        while not self._over:
            with suppress(Exception):  # a scheduler out of reach answers later, or `_check_company` finds it gone
                self._workers = threads_of(self.client)
                if self._stopping:
                    flying = {flight.worker for flight in self._flights.values()}
                    self.client.run(stop_here, self._topic, workers=[*flying & self._workers.keys()], on_error="ignore")
            self._look.wait(LOOK_EVERY)
            if not self._over:
                self._look.clear()


def _root(error: BaseException) -> str:
    """What was raised first, in one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    return f"{type(error).__name__}: {first_line(error)}"
