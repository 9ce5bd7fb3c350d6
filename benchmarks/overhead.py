"""What a run costs besides its trials: a sweep of many tiny runs, its time on the clock minus that of its task.

python benchmarks/overhead.py [--conditions 100] [--seeds 100] [--log epochs] [--out FOLDER]

The task is a formula in place of the robot. What is left is planning, learner, log, tables, checksums and the disk; the
learner is timed besides, for it belongs to the task of a real run.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from study.toy import toy

from wobblesim.config import SweepConfig, parse_config
from wobblesim.learning.run import Learner
from wobblesim.study.execute import sweep


@dataclass(frozen=True)
class Overhead:
    """Milliseconds a run: all but the trials; the learner's part of it; processor time of the whole."""

    runs: int
    milliseconds: float
    learner: float
    processor: float

    def __str__(self) -> str:
        return (
            f"{self.runs:,} runs: {self.milliseconds:.2f} ms a run besides its trials, {self.learner:.2f} of it in the "
            f"learner; {self.processor:.2f} ms of processor time"
        )


def tiny(conditions: int, seeds: int, log: str = "epochs") -> SweepConfig:
    """A grid of runs of two epochs."""
    amplitudes = [round(0.1 + 0.5 * place / conditions, 5) for place in range(conditions)]
    return parse_config(
        f"name: tiny\nseeds: 0..{seeds - 1}\nlog: {log}\nrobot: {{kind: starfish, arms: 3, sections: 2}}\n"
        "learning: {epochs: 2}\nwobble: {dimension: mass, amplitude: 0.1, period: 5, end: 1}\n"
        f"sweep: {{wobble.amplitude: {amplitudes}}}"
    )


def measure(conditions: int, seeds: int, folder: Path, log: str = "epochs") -> Overhead:
    """Run such a sweep into an empty folder."""
    spent = {"trials": 0.0, "learner": 0.0}

    def timed_toy(body: Any, behaviours: np.ndarray, **options: Any) -> Any:
        begun = time.perf_counter()
        trials = toy(body, behaviours, **options)
        spent["trials"] += time.perf_counter() - begun
        return trials

    advance = Learner.advance

    def timed_advance(self: Learner) -> Any:
        begun = time.perf_counter()
        epoch = advance(self)
        spent["learner"] += time.perf_counter() - begun
        return epoch

    config = tiny(conditions, seeds, log)
    Learner.advance = timed_advance
    begun, processor = time.perf_counter(), time.process_time()
    try:
        done = sweep(config, folder, simulate=timed_toy).done
    finally:
        Learner.advance = advance
    taken, processor = time.perf_counter() - begun, time.process_time() - processor
    learner = spent["learner"] - spent["trials"]
    return Overhead(done, *(1e3 * time / done for time in (taken - spent["trials"], learner, processor)))


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--conditions", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--log", default="epochs", choices=["epochs", "trials", "behaviours"])
    parser.add_argument("--out", type=Path, help="where to make the passing folder: which disk it is matters")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=given.out) as folder:
        print(measure(given.conditions, given.seeds, Path(folder), given.log))


if __name__ == "__main__":
    main()
