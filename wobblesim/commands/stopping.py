"""Ctrl-C, SIGTERM and a lost terminal: the first asks for an orderly end, the second ends at once."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

ONE_HANGUP = 2.0
"""s within which a SIGHUP belongs to the signal before it: the system, the shell and the session each send one when a
terminal is closed."""


@contextmanager
def stop_on_signals(first: Callable[[], None], second: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Turn SIGINT, SIGTERM and SIGHUP into a question that can be asked: should we stop?

    SIGHUP stays ignored where it is (nohup).

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
    heeded = [number for number in SIGNALS if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN]
    earlier = {number: signal.signal(number, _only_wake) for number in heeded}
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
    since = 0.0
    while received := ours.recv(16):
        for number in received:
            if number not in SIGNALS:
                continue
            if not asked.is_set():
                asked.set()
                since = time.monotonic()
                first()
            elif number != signal.SIGHUP or time.monotonic() - since > ONE_HANGUP:
                second()
                os._exit(128 + number)
