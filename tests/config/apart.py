"""A configuration read in a process of its own, for its time and its memory."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

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


def read_apart(path: Path, text: str, within: float) -> Reading:
    """Write a file, and read it as a configuration; importing the package counts as memory, not as time.

    A machine that is busy makes everything take longer, and never makes it faster: what takes longer than ``within``
    seconds is tried again, and the least of five times is what it took.
    """
    path.write_text(text, encoding="utf-8")
    command, found = [sys.executable, "-c", SCRIPT, str(path)], []
    while len(found) < 5 and not any(one.seconds < within for one in found):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
        found.append(Reading(*json.loads(done.stdout)))
    return min(found, key=lambda one: one.seconds)
