"""How far `midpoint` is from what this machine can do: operations a step against measured peaks.

python benchmarks/roofline.py

Peaks come from loops of independent operations on rows in registers, and from copying rows of 16 lanes within the
caches. Operations are counted from the elimination plan and the step's source. One thread; minimum of repeats.
"""

from __future__ import annotations

import time

import numba
import numpy as np

import wobblesim as ws
from wobblesim.numerics.throughput import conditions
from wobblesim.physics.lanes import aligned_zeros, fma, lanes, load, square_root, store
from wobblesim.physics.ordering import eliminate

REPEATS = 15
jit = numba.njit(nogil=True, _nrt=False)


def best(function, *arguments):
    """Seconds of the quickest of some calls, in processor time."""
    function(*arguments)
    times = []
    for _ in range(REPEATS):
        begun = time.thread_time()
        function(*arguments)
        times.append(time.thread_time() - begun)
    return min(times)


@jit
def multiply_add(tag, array, n):
    """Eight independent chains of fused multiply-adds."""
    a, b, c, d = load(tag, array, 0), load(tag, array, 1), load(tag, array, 2), load(tag, array, 3)
    e, f, g, h = load(tag, array, 4), load(tag, array, 5), load(tag, array, 6), load(tag, array, 7)
    x, y = load(tag, array, 8), load(tag, array, 9)
    for _ in range(n):
        a, b, c, d = fma(a, x, y), fma(b, x, y), fma(c, x, y), fma(d, x, y)
        e, f, g, h = fma(e, x, y), fma(f, x, y), fma(g, x, y), fma(h, x, y)
    store(tag, array, 10, a + b + c + d + e + f + g + h)


@jit
def divide(tag, array, n):
    """Four independent chains of divisions."""
    a, b, c, d = load(tag, array, 0), load(tag, array, 1), load(tag, array, 2), load(tag, array, 3)
    x = load(tag, array, 8)
    for _ in range(n):
        a, b, c, d = x / a, x / b, x / c, x / d
    store(tag, array, 10, a + b + c + d)


@jit
def root(tag, array, n):
    """Four independent chains of square roots."""
    a, b, c, d = load(tag, array, 0), load(tag, array, 1), load(tag, array, 2), load(tag, array, 3)
    for _ in range(n):
        a, b, c, d = square_root(a), square_root(b), square_root(c), square_root(d)
    store(tag, array, 10, a + b + c + d)


@jit
def copy(tag, source, target, n):
    """Copy rows, n times."""
    for _ in range(n):
        for i in range(len(source)):
            store(tag, target, i, load(tag, source, i))


def peaks(dtype, width):
    """Nanoseconds of one operation on a row, by kind; of moving one row within the first and second cache."""
    tag = lanes(dtype, width)
    array = aligned_zeros(11, tag)
    array[:8], array[8:] = 1.0, 0.5
    n = 100_000
    found = {
        "fma": best(multiply_add, tag, array, n) / (8 * n),
        "division": best(divide, tag, array, n // 10) / (4 * n // 10),
        "root": best(root, tag, array, n // 10) / (4 * n // 10),
    }
    for name, kilobytes in (("copy, 16 kB", 16), ("copy, 200 kB", 200)):
        n_rows = kilobytes * 1024 // 2 // (width * np.dtype(dtype).itemsize)
        source, target = aligned_zeros(n_rows, tag), aligned_zeros(n_rows, tag)
        found[name] = best(copy, tag, source, target, 200) / (200 * n_rows)
    return {name: 1e9 * seconds for name, seconds in found.items()}


def operations(body):
    """Of a step of `midpoint` in flight, for one lane: arithmetic instructions, operations, divisions, roots, rows."""
    plan = eliminate(body.springs, body.n_nodes)
    springs, blocks, pairs, nodes = body.n_springs, plan.n_blocks, len(plan.pairs), body.n_nodes
    # counted in the source of midpoint.py; a fused multiply-add is one instruction and two operations
    return {
        "instructions": springs * (16 + 10) + blocks * (19 + 6 + 4) + pairs * 12 + nodes * (9 + 5),
        "operations": springs * (19 + 20) + blocks * (24 + 8 + 8) + pairs * 20 + nodes * (11 + 8),
        "divisions": springs + 2 * nodes,
        "roots": springs,
        "rows": springs * (9 + 7 + 6) + blocks * (8 + 8 + 6) + pairs * 10 + nodes * (5 + 13),
    }


def step_time(body, dtype, width):
    """Seconds of a step of a full block in flight, the costs of a call taken off."""
    behaviours = np.random.default_rng(1).random((width, 2 * body.n_groups))

    def run(steps):
        ws.simulate(body, behaviours, scene=ws.Scene(floor=None), physics=ws.Physics(dt=0.02, precision=dtype),
                    duration=0.02 * steps, threads=1, width=width)  # fmt: skip

    return (best(run, 1100) - best(run, 100)) / 1000


def main():
    """Print the peaks and, for the starfish, the least times they allow beside the measured one."""
    body = ws.starfish()
    count = operations(body)
    print(", ".join(f"{name} {value}" for name, value in conditions().items()))
    print("a step in flight, one lane:", ", ".join(f"{value:,} {name}" for name, value in count.items()))
    for dtype, width in (("float32", 16), ("float32", 8), ("float64", 8)):
        peak = peaks(np.dtype(dtype), width)
        arithmetic = 1e-3 * count["instructions"] * peak["fma"]
        divider = 1e-3 * (count["divisions"] * peak["division"] + count["roots"] * peak["root"])
        near, far = (1e-3 * count["rows"] * peak[f"copy, {size} kB"] / 2 for size in (16, 200))
        measured = 1e6 * step_time(body, dtype, width)
        print(f"\n{dtype} x {width}:", ", ".join(f"{name} {value:.2f} ns" for name, value in peak.items()))
        print(f"  least time by arithmetic {arithmetic:.2f} us, divider {divider:.2f} us, moving rows {near:.2f} us"
              f" if all are in the first cache, {far:.2f} us if none is")  # fmt: skip
        print(f"  measured {measured:.2f} us a step of a block: {arithmetic / measured:.0%} of the arithmetic peak,"
              f" {count['operations'] * width / measured / 1e3:.0f} GFlop/s")  # fmt: skip


if __name__ == "__main__":
    main()
