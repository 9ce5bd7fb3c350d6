"""Cost of a lane-step over the number of lanes and the number of nodes: table and picture.

python benchmarks/scaling.py [PICTURE]

The cost must be flat in lanes, up to the padding of the last block, and linear in nodes. One thread, float32, dt 0.02,
on the floor; minimum of repeats, in processor time; the cost of a call taken off.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from matplotlib.figure import Figure

import wobblesim as ws
from wobblesim.numerics.throughput import conditions

REPEATS = 5
LANES = (1, 2, 4, 8, 12, 16, 20, 24, 32, 48, 64, 80, 100, 128, 200, 400)
BODIES = {50: (5, 4), 108: (6, 8), 500: (12, 20), 2000: (12, 83)}
"""Nodes wanted, and the arms and sections that come near: an arm of s sections has 2 (s + 1) nodes."""


def seconds(body, n_trials, steps):
    """Processor time of the quickest of some calls."""
    behaviours = np.random.default_rng(1).random((n_trials, 2 * body.n_groups))
    times = []
    for _ in range(REPEATS + 1):
        begun = time.thread_time()
        ws.simulate(body, behaviours, physics=ws.Physics(dt=0.02), duration=0.02 * steps, threads=1)
        times.append(time.thread_time() - begun)
    return min(times[1:])


def cost(body, n_trials):
    """Microseconds of a lane-step."""
    steps = max(50, int(4e5 / (body.n_nodes * max(n_trials, 16))))
    return 1e6 * (seconds(body, n_trials, 2 * steps) - seconds(body, n_trials, steps)) / (steps * n_trials)


def main():
    """Print both tables, draw both curves."""
    print(", ".join(f"{name} {value}" for name, value in conditions().items()))
    body = ws.starfish()
    by_lanes = {n: cost(body, n) for n in LANES}
    by_nodes = {}
    for arms, sections in BODIES.values():
        robot = ws.starfish(arms=arms, sections=sections)
        by_nodes[robot.n_nodes] = cost(robot, 32)
    print("\nlanes  us a lane-step")
    for n, value in by_lanes.items():
        print(f"{n:5d}  {value:.3f}")
    print("\nnodes  us a lane-step  ns a node")
    for n, value in by_nodes.items():
        print(f"{n:5d}  {value:14.3f}  {1e3 * value / n:9.2f}")
    draw(by_lanes, by_nodes).savefig(sys.argv[1] if len(sys.argv) > 1 else "scaling.png", dpi=150)


def draw(by_lanes, by_nodes):
    """Two panels, logarithmic axes."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.loglog(list(by_lanes), list(by_lanes.values()), "o-", color="#0072B2")
    left.set(xlabel="lanes (robots in one call)", ylabel="µs a lane-step", title="108 nodes")
    nodes = np.array(list(by_nodes))
    right.loglog(nodes, list(by_nodes.values()), "o", color="#0072B2", label="measured")
    right.loglog(nodes, by_nodes[108] / 108 * nodes, "--", color="#D55E00", label="linear")
    right.set(xlabel="nodes", ylabel="µs a lane-step", title="32 lanes")
    right.legend(frameon=False)
    for axes, ticks in ((left, (1, 4, 16, 64, 400)), (right, nodes)):
        axes.set_xticks(ticks, [str(tick) for tick in ticks])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    main()
