"""A task that takes microseconds in place of the robot's, and studies made of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from wobblesim.config import SweepConfig, parse_config
from wobblesim.physics.simulate import Trials
from wobblesim.study.files import read_tables
from wobblesim.study.manifest import read_manifest

STUDY = """
name: toy
seeds: 0..3
robot: {kind: starfish, arms: 3, sections: 2}
learning: {epochs: 12}
log: behaviours
conditions:
  fixed: {wobble: null}
  mass: {wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 6}}
"""


def study(*settings: str, seeds: str | None = None) -> SweepConfig:
    """The toy study with changes."""
    return parse_config(STUDY, settings, seeds)


def toy(body: Any, behaviours: np.ndarray, *, morphology: Any, **_: Any) -> Trials:
    """A smooth function of the behaviour and of the mass; one in twelve or so diverges, and as many are refined."""
    half = behaviours.shape[1] // 2
    place = (behaviours[:, :half] * np.cos(2 * np.pi * behaviours[:, half:])).sum(axis=1) * morphology.mass
    return outcome(place, diverged=behaviours[:, 0] > 0.92, refined=behaviours[:, 0] < 0.08)


def outcome(place: np.ndarray, diverged: np.ndarray, refined: np.ndarray | bool = False) -> Trials:
    """Trials that end at `place`, some after two halvings of the step, but for those that diverged."""
    return Trials(
        displacement=np.where(diverged, np.nan, place),
        status=np.where(diverged, "diverged", np.where(refined, "refined", "ok")),
        dt=np.where(diverged, 0.00125, np.where(refined, 0.0025, 0.01)),
        bound=np.where(diverged, "energy", np.where(refined, "strain", "")),
        limited=np.zeros(len(place), dtype=np.int64),
        diverged_at=np.where(diverged, 1.25, np.nan),
        inverted=np.zeros(len(place), dtype=np.int64),
        positions=None,
    )


def slow_toy(seconds: float) -> Callable[..., Trials]:
    """The same task, taking its time."""

    def simulate(*arguments: Any, **settings: Any) -> Trials:
        time.sleep(seconds)
        return toy(*arguments, **settings)

    return simulate


class StopAfter:
    """Asks a sweep to stop once it has been asked so often."""

    def __init__(self, times: int) -> None:
        self.times = times

    def __call__(self) -> bool:
        self.times -= 1
        return self.times < 0


TABLES = ("runs", "epochs", "trials", "behaviours")


def content(folder: Path) -> dict[str, bytes]:
    """All rows of all tables as bytes, but for the wall time."""
    manifest = read_manifest(folder)
    found = {}
    for name in TABLES:
        for file in sorted(manifest.files(name)):
            table = read_tables(folder, [file])
            if name == "runs":
                table = table.drop_columns(["seconds"])
            found[file.path] = as_bytes(table)
    return found


def as_bytes(table: pa.Table) -> bytes:
    """The values of a table, NaNs with their bits, as one string of bytes."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table.combine_chunks())
    return sink.getvalue().to_pybytes()
