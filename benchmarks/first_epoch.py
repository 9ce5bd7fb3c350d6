"""Time from the command to the end of the first epoch, with cold and with warm kernels.

python benchmarks/first_epoch.py [CONFIG]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

CHILD = """
import sys, time
import wobblesim.study.execute
from wobblesim.commands import main
from wobblesim.learning.run import Learner

advance = Learner.advance

def first(self):
    epoch = advance(self)
    print("FIRST", time.time(), flush=True)
    Learner.advance = advance
    return epoch

Learner.advance = first
main(sys.argv[1:])
"""


def first_epoch(config: str, cache: str) -> float:
    """Seconds until the first epoch is done, kernels kept in a folder of their own."""
    with tempfile.TemporaryDirectory() as out:
        begun = time.time()
        done = subprocess.run(
            [sys.executable, "-c", CHILD, "sweep", config, "--out", f"{out}/results", "--progress", "none"],
            env=os.environ | {"NUMBA_CACHE_DIR": cache}, capture_output=True, text=True, check=True,
        )  # fmt: skip
    line = next(line for line in done.stdout.splitlines() if line.startswith("FIRST"))
    return float(line.split()[1]) - begun


def main() -> None:
    """Print the least of three, cold and warm."""
    config = sys.argv[1] if len(sys.argv) > 1 else "configs/smoke.yaml"
    cold, warm = [], []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(first_epoch(config, cache))
            warm.append(first_epoch(config, cache))
    print(f"{config}: first epoch after {min(cold):.1f} s cold, {min(warm):.1f} s warm")


if __name__ == "__main__":
    main()
