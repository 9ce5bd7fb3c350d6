"""Checkpoints: what a group of runs has done so far, so that the same command goes on from there with the same bits.

    checkpoints/condition=<id>/seeds-<first>-<number of seeds>/
        state.npz                    the learner (population, what is known of it, random numbers), and where it stands
        part-0.npz, part-1.npz, ...  the epochs between two checkpoints, as columns

The state names how many parts belong to it and is replaced last and at once; a part beyond its count says nothing.
All are plain arrays without pickle, with a checksum for each array (zip), which is checked on reading.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import shutil
import zipfile
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wobblesim.study.errors import not_written
from wobblesim.study.files import write_atomically
from wobblesim.study.group import Group
from wobblesim.study.manifest import RunKey
from wobblesim.study.schema import SCHEMA_VERSION
from wobblesim.study.store import CHECKPOINTS

if TYPE_CHECKING:  # `wobblesim status` need not wait for the simulator to be imported
    from wobblesim.study.rows import Columns

LEARNER = "learner."
# RuntimeError: what zipfile says of a flag that it does not know, as a flipped bit may set one.
UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile)


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Where a group stands.

    Attributes
    ----------
    group : Group
    snapshot : dict of arrays
        Of `Learner.snapshot`.
    parts : list of Columns
        Of `Log.cut`, in order.
    seconds : float
        Wall time spent on the group so far.
    """

    group: Group
    snapshot: dict[str, np.ndarray]
    parts: list[Columns]
    seconds: float

    @property
    def epoch(self) -> int:
        """The epoch that comes next."""
        return int(self.snapshot["epoch"])


def identity(condition: Mapping[str, Any]) -> str:
    """Hash of what a condition is, as the manifest has it, and of the version of the tables.

    A checkpoint of another condition is of no use, nor is one that lacks what the tables need.
    """
    return hashlib.sha256(json.dumps([SCHEMA_VERSION, condition], sort_keys=True).encode()).hexdigest()


def save(
    folder: Path,
    scratch: Path,
    group: Group,
    identity: str,
    snapshot: Mapping[str, np.ndarray],
    part: Columns,
    parts: int,
    seconds: float,
) -> None:
    """Keep where a group stands.

    Parameters
    ----------
    folder, scratch : Path
        Of the results, and where files are made.
    group : Group
    identity : str
        Of its condition.
    snapshot : mapping of arrays
    part : Columns
        The epochs since the last checkpoint; empty if there are none.
    parts : int
        How many parts there are now, this one included.
    seconds : float

    Raises
    ------
    WriteError
        If it cannot be written.
    """
    place = _place(folder, group)
    if part:
        _write(place / f"part-{parts - 1}.npz", scratch, part)
    head = {
        "condition": np.array(group.condition),
        "seeds": np.array(group.seeds),
        "identity": np.array(identity),
        "parts": np.array(parts),
        "seconds": np.array(seconds),
    }
    _write(place / "state.npz", scratch, head | {f"{LEARNER}{name}": array for name, array in snapshot.items()})


def _place(folder: Path, group: Group) -> Path:
    """A folder of the group's own: two groups may begin with the same seed and be of one size."""
    digest = hashlib.sha256(str(group.seeds).encode()).hexdigest()[:8]
    return folder / CHECKPOINTS / f"condition={group.condition}" / f"seeds-{group.seeds[0]}-{len(group.seeds)}-{digest}"


def _write(path: Path, scratch: Path, arrays: Mapping[str, np.ndarray]) -> None:
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]  # the stubs take `allow_pickle` for one of the names
    write_atomically(path, scratch, content.getbuffer())


def load(folder: Path, group: Group, identity: str) -> Checkpoint | None:
    """Where a group of this condition stands; None if it has no checkpoint that can be read, or only another's."""
    place = _place(folder, group)
    try:
        state = _read(place / "state.npz")
        if tuple(state["seeds"].tolist()) != group.seeds or str(state["identity"]) != identity:
            return None
        parts = [_read(place / f"part-{number}.npz") for number in range(int(state["parts"]))]
        snapshot = {name.removeprefix(LEARNER): array for name, array in state.items() if name.startswith(LEARNER)}
        _check_epochs(parts, int(snapshot["epoch"]))
        return Checkpoint(group, snapshot, parts, float(state["seconds"]))
    except UNREADABLE:
        return None


def _check_epochs(parts: list[Columns], epoch: int) -> None:
    """Refuse parts that do not follow each other: two processes that believed they held the group have written them."""
    found = [number for part in parts for number in part["epochs.epoch"][:, 0].tolist()]
    if found != list(range(epoch)):
        raise ValueError(f"the parts hold other epochs than 0 to {epoch - 1}")


def _read(path: Path) -> dict[str, np.ndarray]:
    # NumPy leaves a file open that is no archive, if it has opened it itself.
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return dict(archive)


def begun(folder: Path, conditions: Mapping[str, Any], present: Collection[RunKey]) -> list[Group]:
    """Groups to go on with, of conditions as the manifest has them.

    The checkpoint of a group whose runs are all present is removed: a crash came between storing them and removing it.
    """
    found = []
    for place in _places(folder):
        head = _head(place)
        if (
            head
            and _place(folder, head.group) == place
            and head.identity == identity(conditions.get(head.group.condition, {}))
        ):
            found.append(head.group)
    done = [group for group in found if all(run in present for run in group.runs)]
    for group in done:
        discard(folder, group)
    return [group for group in found if group not in done]


def _places(folder: Path) -> list[Path]:
    return sorted((folder / CHECKPOINTS).glob("condition=*/seeds-*"))


@dataclass(frozen=True)
class Head:
    """What a checkpoint says of itself without its arrays."""

    group: Group
    identity: str
    epoch: int


def _head(place: Path) -> Head | None:
    """The head of a checkpoint; None if it cannot be read."""
    try:
        with (place / "state.npz").open("rb") as file, np.load(file, allow_pickle=False) as archive:
            group = Group(str(archive["condition"]), tuple(archive["seeds"].tolist()))
            return Head(group, str(archive["identity"]), int(archive[f"{LEARNER}epoch"]))
    except UNREADABLE:
        return None


def standing(folder: Path, condition: str) -> list[Head]:
    """The checkpoints of a condition."""
    heads = map(_head, sorted((folder / CHECKPOINTS / f"condition={condition}").glob("seeds-*")))
    return [head for head in heads if head]


def sweep_up(folder: Path) -> list[str]:
    """Remove checkpoints that cannot be read, and name them: their runs start anew."""
    unreadable = [
        place
        for place in _places(folder)
        if not (head := _head(place)) or load(folder, head.group, head.identity) is None
    ]
    for place in unreadable:
        shutil.rmtree(place, ignore_errors=True)
    return [f"the checkpoint {place} cannot be read: its runs start anew" for place in unreadable]


def useful(groups: Collection[Group], is_wanted: Callable[[RunKey], bool], present: Collection[RunKey]) -> list[Group]:
    """Of the groups begun, those to go on with: what they miss is wanted, and none is run twice."""
    taken: set[RunKey] = set()
    chosen = []
    for group in groups:
        missing = {run for run in group.runs if run not in present}
        if missing and all(map(is_wanted, missing)) and not missing & taken:
            chosen.append(group)
            taken |= missing
    return chosen


def discard(folder: Path, group: Group) -> None:
    """Remove the checkpoint of a group, if it has one.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    place = _place(folder, group)
    try:
        # The state goes first: parts without a state say nothing.
        (place / "state.npz").unlink(missing_ok=True)
    except OSError as error:
        raise not_written(place, error) from error
    shutil.rmtree(place, ignore_errors=True)
    _remove_if_empty(place.parent)


def _remove_if_empty(folder: Path) -> None:
    """Remove a folder that holds nothing."""
    with contextlib.suppress(OSError):
        folder.rmdir()
