"""What is known of an object besides its value."""

from __future__ import annotations

import weakref
from typing import Generic, TypeVar

Known = TypeVar("Known")


class Beside(Generic[Known]):
    """Keeps one thing beside each of several objects, for as long as that object lives.

    A frozen model cannot hold what was worked out from it: two equal ones would differ, and a changed copy would take
    along what is no longer true of it. An object is told by its identity.
    """

    def __init__(self) -> None:
        self._kept: dict[int, Known] = {}

    def keep(self, owner: object, known: Known) -> None:
        """Keep something, in place of what was kept before."""
        if id(owner) not in self._kept:
            weakref.finalize(owner, self._kept.pop, id(owner)).atexit = False
        self._kept[id(owner)] = known

    def of(self, owner: object) -> Known | None:
        """Return what was kept, or None."""
        return self._kept.get(id(owner))
