"""Times and memory of processes of their own, and of a configuration that is read in one."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
SCRIPT = """
import json, resource, sys, time
from wobblesim.config import ConfigError, expand, load_config
begun, said, conditions = time.process_time(), "", 0
try:
    conditions = len(expand(load_config(sys.argv[1])))
except ConfigError as error:
    said = error.report()
seconds = time.process_time() - begun
try:  # of this process alone; what getrusage says counts in the process that started it
    (peak,) = [int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith("VmHWM")]
except OSError:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps([said, conditions, seconds, peak]))
"""


@dataclass(frozen=True)
class Reading:
    """What came of reading a file: the errors, or how many conditions; processor time in s, peak memory in bytes."""

    said: str
    conditions: int
    seconds: float
    peak: int


@dataclass(frozen=True)
class Timed:
    """Processor time, s, and what else was told."""

    seconds: float
    told: Any = None


PAUSES = (0.0, 0.0, 1.0, 2.0, 4.0)
"""Before each try, s: what else is at work on the machine may be over then."""

YARDSTICK = """
import time
made = {str(i): (i, [str(i)]) for i in range(150_000)}
sorted(made, key=lambda name: made[name][1])
print(time.process_time())
"""
USUAL = 0.17
"""Processor time of the yardstick where the times were measured that are noted beside the bounds, s."""


def quickest(measure: Callable[[], Any], within: float) -> Any:
    """What `measure` returns, of up to five tries that of the fewest ``seconds``; none after one below ``within``.

    A machine that is busy makes everything take longer, and never makes it faster; so does a first import, which has to
    compile. If the first try was not below, the machine may also be a slow one, or lent out beside others that cannot
    be seen from here. So a yardstick is measured after each try, and from the second on ``seconds`` are those of a
    machine on which it takes `USUAL`.
    """
    found, yardsticks = [], []
    for pause in PAUSES:
        time.sleep(pause)
        found.append(measure())
        if found[-1].seconds < within:
            return found[-1]
        yardsticks.append(_yardstick())
        slowdown = max(1.0, min(yardsticks) / USUAL)
        least = min(found, key=lambda one: one.seconds)
        if len(found) > 1 and least.seconds / slowdown < within:
            break
    return replace(least, seconds=least.seconds / slowdown)


def _yardstick() -> float:
    found = subprocess.run([sys.executable, "-c", YARDSTICK], capture_output=True, check=True)
    return float(found.stdout)


def read_apart(path: Path, text: str, within: float) -> Reading:
    """Write a file, and read it as a configuration, see `quickest`.

    Importing the package counts as memory, not as time.
    """
    path.write_text(text, encoding="utf-8")
    command = [sys.executable, "-c", SCRIPT, str(path)]

    def read() -> Reading:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
        return Reading(*json.loads(done.stdout))

    return quickest(read, within)
