"""Where the time of a full run goes: kernels, the calls around them, learner, log, Parquet.

python benchmarks/shares.py

One lone seed of benchmarks/full-run.yaml, cut to a tenth, kernels warm. Wall time of the parts as they nest.
"""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import wobblesim.learning.run as learning
import wobblesim.physics.simulate as physics
import wobblesim.study.execute as execute
from wobblesim.config import load_config

CUT = ("learning.epochs=400", "wobble.end=200", "wobble.decay_start=190")
spent: dict[str, float] = defaultdict(float)


def timed(owner: Any, name: str, label: str) -> None:
    """Replace a function by one that adds up its time."""
    function = getattr(owner, name)

    def wrapped(*arguments: Any, **options: Any) -> Any:
        begun = time.perf_counter()
        try:
            return function(*arguments, **options)
        finally:
            spent[label] += time.perf_counter() - begun

    setattr(owner, name, wrapped)


def main() -> None:
    """Print each part's seconds and share of the sweep."""
    config = load_config("benchmarks/full-run.yaml", CUT)
    with tempfile.TemporaryDirectory() as folder:  # kernels, caches and imports
        execute.sweep(load_config("benchmarks/full-run.yaml", ("learning.epochs=2", "wobble.end=1", "wobble.period=3",
                                                               "wobble.decay_start=1")), Path(folder))  # fmt: skip
    timed(physics, "_run_block", "blocks, both threads")
    timed(physics, "advance", "kernels, both threads")
    timed(learning.Learner, "_try", "trials")
    timed(learning.Learner, "advance", "epochs")
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        execute.sweep(config, Path(folder))
        total = time.perf_counter() - begun
    kernels = spent["kernels, both threads"] / 2
    parts = {
        "kernels (half of both threads' time)": kernels,
        "waiting for the slower thread, laying out, reading off": spent["trials"] - kernels,
        "learner": spent["epochs"] - spent["trials"],
        "log, Parquet, checkpoints, manifest": total - spent["epochs"],
    }
    print(f"total {total:.2f} s")
    for name, seconds in parts.items():
        print(f"{name:58s} {seconds:7.3f} s {100 * seconds / total:6.2f} %")


if __name__ == "__main__":
    main()
