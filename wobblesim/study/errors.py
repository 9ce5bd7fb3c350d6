"""What can go wrong with a results folder, as the user is told it."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

NO_SPACE = (errno.ENOSPC, errno.EDQUOT)

BLOCK = 4096
"""Bytes that a new folder or a new name takes, at most, on most file systems."""


class StoreError(Exception):
    """The folder cannot be used as asked; the message is one sentence with its remedy, or a table and a sentence."""


class WriteError(StoreError):
    """A result could not be written; what was committed before is untouched."""


def not_written(path: Path, error: OSError, need: int = BLOCK) -> WriteError:
    """What to tell of a file that the system refuses to write.

    Parameters
    ----------
    path : Path
    error : OSError
    need : int
        Bytes that were to be written.
    """
    remedy, room = "put that right", ""
    if error.errno in NO_SPACE:
        remedy = "make room (`sweep --dry-run` says how much all of it takes)"
        room = f" ({_in_words(need)} needed, {_in_words(_free(path))} free)"
    return WriteError(f"cannot write {path}: {reason(error)}{room}; {remedy} and give the same command again")


def unwritable(folder: Path, error: OSError | ValueError) -> StoreError:
    """What to tell of a folder that cannot be written to."""
    if isinstance(error, OSError) and error.errno in NO_SPACE:
        return not_written(folder, error)
    return StoreError(f"cannot write to {folder}: {reason(error)}; choose another folder with --out")


def _free(path: Path) -> int:
    """Bytes that are free where a file is to be."""
    folder = next(place for place in path.absolute().parents if place.is_dir())
    return shutil.disk_usage(folder).free


def _in_words(size: int) -> str:
    """A number of bytes to three digits or so."""
    for unit, one in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= one:
            return f"{size / one:.3g} {unit}"
    return f"{size} bytes"


def reason(error: OSError | ValueError) -> str:
    """Why the system refuses, in its words."""
    return (getattr(error, "strerror", None) or str(error)).lower()


def first_line(error: BaseException) -> str:
    """The first line of an error's message."""
    return str(error).strip().partition("\n")[0]
