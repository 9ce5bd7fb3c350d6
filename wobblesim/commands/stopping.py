"""Ctrl-C: the first asks for an orderly end, the second ends at once."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def stop_on_signals(first: Callable[[], None], second: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Turn SIGINT and SIGTERM into a question that can be asked: should we stop?

    Python runs signal handlers between two of its own instructions, and the main thread may be in a kernel for
    seconds. The system's part of the handler writes to a socket at once, so a thread that waits there can answer.

    Parameters
    ----------
    first : callable
        Called, in another thread, with the first signal.
    second : callable
        Called with the second one, just before the process ends with 128 + the number of the signal.
    """
    asked = threading.Event()
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)
    earlier = {number: signal.signal(number, _only_wake) for number in SIGNALS}
    earlier_fd = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
    watcher = threading.Thread(target=_watch, args=(ours, asked, first, second), daemon=True)
    watcher.start()
    try:
        yield asked.is_set
    finally:
        signal.set_wakeup_fd(earlier_fd)
        for number, handler in earlier.items():
            signal.signal(number, handler)
        theirs.close()
        watcher.join()
        ours.close()


def _only_wake(number: int, frame: FrameType | None) -> None:
    """Do nothing: that there is a handler makes the system write to the socket."""


def _watch(ours: socket.socket, asked: threading.Event, first: Callable[[], None], second: Callable[[], None]) -> None:
    while received := ours.recv(16):
        for number in received:
            if number not in SIGNALS:
                continue
            if asked.is_set():
                second()
                os._exit(128 + number)
            asked.set()
            first()
