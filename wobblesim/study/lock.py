"""Who may write to a results folder: one process the whole of it, or shards of a job array each its own part.

All is `flock`: the system drops a lock with the process that holds it, however that ends, so that there is never a file
to remove by hand.
"""

from __future__ import annotations

import fcntl
import os
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from wobblesim.study.errors import StoreError, reason, unwritable
from wobblesim.study.files import make_folder

LOCK = ".lock"

LOCK_PATIENCE = 0.5
"""s to wait for a lock: a second writer is refused within a second."""


@dataclass(frozen=True)
class Shard:
    """One of the parts that the runs of a study are dealt to, so that each can be a job of its own.

    Attributes
    ----------
    number, count : int
        Such as 2 of 8; the first is 1.
    """

    number: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise ValueError(f"there is no shard {self.number} of {self.count}; the first is 1/{self.count}")

    @classmethod
    def of(cls, text: str) -> Shard:
        """Read a shard such as ``2/8``.

        Raises
        ------
        ValueError
            If it is none.
        """
        match = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text, re.ASCII)
        if not match:
            raise ValueError(f"{text!r} is not a shard; write k/n, such as 2/8 for the second of eight")
        return cls(int(match[1]), int(match[2]))

    def __str__(self) -> str:
        return f"{self.number}-of-{self.count}"


@contextmanager
def held(folder: Path, shard: Shard | None = None, study: str = "") -> Iterator[None]:
    """Hold a folder, made if need be, or a shard's part of it.

    Parameters
    ----------
    folder : Path
    shard : Shard, optional
    study : str
        What tells studies apart: shards that are at work together must be of one study.

    Raises
    ------
    StoreError
        If it cannot be written to, or if another process holds it.
    """
    with _lock_file(folder, LOCK) as lock:
        _take(folder, lock, fcntl.LOCK_SH if shard else fcntl.LOCK_EX, "")
        if shard is None:
            _sign(folder, lock, "")
            yield
            return
        with _lock_file(folder, f"{LOCK}-{shard}") as own:
            _take(folder, own, fcntl.LOCK_EX, f"the shard {shard.number}/{shard.count} of ")
            _sign(folder, own, study)
            _refuse_strangers(folder, shard, study)
            yield


def _lock_file(folder: Path, name: str) -> TextIO:
    try:
        make_folder(folder)
        return (folder / name).open("a+", encoding="utf-8")
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise unwritable(folder, error) from error


def _take(folder: Path, lock: TextIO, kind: int, what: str) -> None:
    try:
        _lock_within(lock, kind, LOCK_PATIENCE)
    except BlockingIOError:
        holders = ", ".join(writers(folder)) or "another process"
        raise StoreError(
            f"{what}{folder} is in use by {holders}; wait for it to end or choose another folder with --out"
        ) from None
    except OSError as error:
        raise unwritable(folder, error) from error


def _sign(folder: Path, lock: TextIO, study: str) -> None:
    """Say in a lock who holds it, and of which study."""
    text = f"process {os.getpid()} on {socket.gethostname()}\n{study}"
    try:
        os.ftruncate(lock.fileno(), 0)
        os.write(lock.fileno(), text.encode())
    except OSError as error:
        raise unwritable(folder, error) from error


def _lock_within(lock: TextIO, kind: int, seconds: float) -> None:
    """Lock a file, also if somebody who asks who holds it holds it for an instant."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            return fcntl.flock(lock, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def _refuse_strangers(folder: Path, shard: Shard, study: str) -> None:
    """Refuse to work beside shards that deal the runs out in another way, lest two compute the same run.

    Who has just taken a lock has not signed it yet: what an earlier holder has left in it is not held against it.
    """
    deadline = time.monotonic() + LOCK_PATIENCE
    while strangers := _strangers(folder, shard, study):
        if time.monotonic() > deadline:
            name, who = strangers[0]
            raise StoreError(
                f"{folder} is in use by the shard {name.removeprefix(f'{LOCK}-')} ({who}) of another study or number "
                "of shards; wait for it to end, or give the same study and number of shards"
            )
        time.sleep(0.02)


def _strangers(folder: Path, shard: Shard, study: str) -> list[tuple[str, str]]:
    """Locks of shards of another study or number, and who holds them."""
    return [
        (name, who)
        for name, (who, theirs) in _held_locks(folder).items()
        if name.startswith(f"{LOCK}-") and (not name.endswith(f"-of-{shard.count}") or theirs != study)
    ]


def _held_locks(folder: Path) -> dict[str, tuple[str, str]]:
    """The locks of a folder that somebody holds: by the name of the file, who, and of which study."""
    found = {}
    for path in sorted(folder.glob(f"{LOCK}*")):
        try:
            with path.open("r", encoding="utf-8") as lock:
                if not _is_free(lock):
                    who, _, study = lock.read(300).partition("\n")
                    found[path.name] = who.strip() or "another process", study
        except OSError as error:
            raise StoreError(f"cannot read {path}: {reason(error)}") from error
    return found


def _is_free(lock: TextIO) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def writers(folder: Path) -> list[str]:
    """Who is writing to a folder now, such as ``process 12 on host``."""
    told = []
    for name, (who, _) in _held_locks(folder).items():
        number, _, count = name.removeprefix(f"{LOCK}-").partition("-of-")
        told.append(f"{who} (shard {number}/{count})" if count else who)
    return told
