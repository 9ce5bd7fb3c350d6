"""Everything that `wobblesim accuracy` finds, and how it is handed on."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from wobblesim.numerics.accuracy import Agreement, Row, measure, measured_with
from wobblesim.numerics.accuracy_sensitivity import Sensitivity, sensitivity
from wobblesim.numerics.accuracy_verdict import goal, sentence
from wobblesim.numerics.scenes import SCENES


@dataclass(frozen=True)
class Report:
    """Rows of all scenes, what the laws of contact agree on, how sensitive the gait is, and the conditions."""

    short: bool
    rows: list[Row]
    agreements: list[Agreement]
    sensitivities: list[Sensitivity]
    conditions: dict[str, str]
    seconds: float

    @property
    def scenes(self) -> list[str]:
        """The scenes measured, in order."""
        return list(dict.fromkeys(row.scene for row in self.rows))

    def as_data(self) -> dict[str, Any]:
        """Plain dictionaries and lists."""
        found = goal(self.rows)
        return {
            "conditions": self.conditions,
            "short": self.short,
            "seconds": self.seconds,
            "sentence": sentence(self.rows),
            "goal": found and {"ratio": found.ratio, "ours": asdict(found.ours), "theirs": asdict(found.theirs)},
            "rows": [{**asdict(row), "error": row.error, "shipped": row.shipped} for row in self.rows],
            "laws": [asdict(agreement) for agreement in self.agreements],
            "sensitivity": [asdict(found) for found in self.sensitivities],
        }


def make_report(
    scenes: Sequence[str] | None = None,
    integrators: Sequence[str] | None = None,
    *,
    short: bool = False,
    threads: int | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> Report:
    """Measure scene by scene; `tell` hears a line after each. The options are those of `measure`."""
    start, scenes = time.perf_counter(), scenes or tuple(SCENES)
    rows: list[Row] = []
    agreements: list[Agreement] = []
    for place, result in enumerate(measure(scenes, integrators, short=short, threads=threads), 1):
        rows += result.rows
        agreements += result.agreements
        tell(f"{place}/{len(scenes)} {result.scene}: {time.perf_counter() - start:.0f} s so far")
    gauge = list(sensitivity(short=short, threads=threads)) if "long-gait" in scenes else []
    return Report(short, rows, agreements, gauge, measured_with(), time.perf_counter() - start)
