"""Time and memory of planning a million runs, each layout in a process of its own, imports included.

python benchmarks/planning.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

CHILD = """
import json, resource, sys, time
from pathlib import Path

laps, before = {}, time.perf_counter()

def lap(name):
    global before
    now = time.perf_counter()
    laps[name], before = now - before, now

from wobblesim.config import dump, load_config
lap("import of the configuration's part")
config = load_config(sys.argv[1])
lap("reading")
import wobblesim.study.execute
from wobblesim.study.plan import plan, study
from wobblesim.study.store import opened
lap("other imports")
laid_out = study(config)
laid_out.setups
lap("setups")
todo = plan(laid_out, (), (), workers=2, threads=1)
lap("plan")
groups = sum(1 for _ in todo)
lap("going through the groups")
laps["all of planning"] = sum(laps.values())
usage = resource.getrusage(resource.RUSAGE_SELF)
planning = usage.ru_utime + usage.ru_stime, usage.ru_maxrss
with opened(Path(sys.argv[2])) as store:
    store.declare(laid_out.written, laid_out.seeds, dump(config))
lap("declaring it in an empty folder")
with opened(Path(sys.argv[2])) as store:
    store.declare(laid_out.written, laid_out.seeds, dump(config))
lap("opening that again, and comparing")
print(json.dumps({"groups": groups, "laps": laps, "processor": planning[0], "most": planning[1]}))
"""

LAYOUTS = ((100, 100, 100), (100, 10, 1000), (1, 1, 10**6))


def layout(amplitudes: int, periods: int, seeds: int) -> str:
    """A study of so many amplitudes and periods of a wobble."""
    return (
        f"name: big\nseeds: 0..{seeds - 1}\nwobble: {{dimension: mass, amplitude: 0.1, period: 25}}\nsweep:\n"
        f"  wobble.amplitude: {[round(0.005 * (place + 1), 4) for place in range(amplitudes)]}\n"
        f"  wobble.period: {[place + 3 for place in range(periods)]}\n"
    )


def measure(*sizes: int) -> dict:
    """Seconds of each part, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "big.yaml")
        path.write_text(layout(*sizes))
        found = subprocess.run(
            [sys.executable, "-c", CHILD, str(path), str(Path(folder, "out"))],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    return json.loads(found.stdout)


def main() -> None:
    """Print the run of the least processor time of three, for each layout."""
    for amplitudes, periods, seeds in LAYOUTS:
        least = min((measure(amplitudes, periods, seeds) for _ in range(3)), key=lambda found: found["processor"])
        megabytes = least["most"] / (2**20 if sys.platform == "darwin" else 2**10)
        print(f"{amplitudes * periods:,} conditions x {seeds:,} seeds, {least['groups']:,} groups:")
        for name, seconds in least["laps"].items():
            print(f"  {seconds:6.3f} s  {name}")
        print(f"  {least['processor']:6.3f} s  of processor time for planning, {megabytes:.0f} MB at most")


if __name__ == "__main__":
    main()
