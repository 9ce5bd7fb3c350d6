"""What robots really do, for the trusted bounds: the table of docs/physics.md, "Trusted bounds".

256 random behaviours of each of 32 robots for 30 s at a step of 0.00125 s; of each trial the greatest speed of a node,
the greatest strain of a spring and the greatest energy gained, looked for every 4 steps. Takes two minutes on two
cores.

    python benchmarks/bounds.py
"""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import wobblesim as ws
from wobblesim.physics import simulate as loop
from wobblesim.physics.bounds import energy_scale, measured, start_energy
from wobblesim.physics.contract import State, rows, step
from wobblesim.physics.kernels import kernel
from wobblesim.physics.lanes import lanes, larger, load, store
from wobblesim.robot.gait import clock, split_behaviours

EVERY, WIDTH = 4, 16
AMPLITUDES, MASSES, STIFFNESSES, SIZES = (0.1, 0.3), (0.2, 0.5, 1.0, 2.0), (0.5, 2.0), (0.5, 2.0)
PHYSICS, DURATION = ws.Physics(dt=0.00125), 30.0


@kernel
def track(tag, constants, floor, friction, muscles, state, rest, work, bounds, place, watch, most, n_steps):
    """Run one block of lanes; ``most (3, width)``: square of the greatest speed, greatest strain, greatest energy."""
    loop._drift(tag, state, bounds.ahead)
    for n in range(n_steps):
        step(tag, constants, floor, friction, muscles, state, rest, watch, work, n)
        if (n + 1) % EVERY == 0:
            fastest, strain, energy, _ = measured(tag, bounds, state, rest, place)
            store(tag, most, 0, larger(fastest, load(tag, most, 0)))
            store(tag, most, 1, larger(strain, load(tag, most, 1)))
            store(tag, most, 2, larger(energy, load(tag, most, 2)))


def extremes(body: ws.Body, behaviours: np.ndarray, morphology: ws.Morphology, gait: ws.Gait) -> np.ndarray:
    """Greatest speed (u/s), strain and energy gained (energy scales) of each trial, (3, n_trials)."""
    prepared = loop._prepared(loop._Robot(body, morphology, ws.Scene(), gait), PHYSICS)
    system, method, dtype = prepared.system, prepared.method, np.dtype(PHYSICS.precision)
    n_steps = round(DURATION / PHYSICS.dt)
    ticks = clock(gait, PHYSICS.dt, 2 * n_steps + 1).astype(dtype)
    signals, tag = split_behaviours(behaviours, gait), lanes(dtype, WIDTH)

    def run(start: int) -> np.ndarray:
        block, n = loop._Block(tag, signals, start), system.n_nodes
        state = State(*(rows(n, tag) for _ in range(4)))
        for target, source in zip(state, prepared.start.reshape(4, n), strict=True):
            target[:] = source[:, None]
        rest, most = rows(len(system.rest), tag), rows(3, tag)
        rest[:], most[2] = system.rest[:, None], -np.inf
        sine, cosine = map(block.lanes_of, block.signals)
        muscles = prepared.muscles._replace(sine=sine, cosine=cosine, clock=ticks)
        track(
            tag, method.constants, method.floor, method.friction, muscles, state, rest, method.workspace(tag, state),
            prepared.bounds, rows(2 * n, tag), rows(1, tag), most, n_steps,
        )  # fmt: skip
        return most.astype(np.float64)

    with ThreadPoolExecutor() as threads:
        fastest, strain, energy = np.concatenate(list(threads.map(run, range(0, len(behaviours), WIDTH))), axis=1)
    scale = energy_scale(system, body.body_length, gait.max_amplitude)
    return np.stack([np.sqrt(fastest), strain, (energy - start_energy(system)) / scale])


def main() -> None:
    """Print a row for each amplitude and mass: of all stiffnesses and sizes the largest, and the median trial."""
    body, behaviours = ws.starfish(), np.random.default_rng(1).random((256, 24))
    print("| amplitude | mass | speed, u/s: median, largest | strain | energy gained |\n|--:|--:|--:|--:|--:|")
    for amplitude, mass in itertools.product(AMPLITUDES, MASSES):
        robots = [ws.Morphology(mass=mass, stiffness=k, size=size) for k, size in itertools.product(STIFFNESSES, SIZES)]
        found = np.concatenate(
            [extremes(body, behaviours, r, ws.Gait(max_amplitude=amplitude)) for r in robots], axis=1
        )
        (v, strain, energy), (v_most, strain_most, energy_most) = np.median(found, axis=1), found.max(axis=1)
        print(
            f"| {amplitude} | {mass:g} | {v:,.0f}, {v_most:,.0f} | {strain:.2f}, {strain_most:.2f} "
            f"| {energy:.3f}, {energy_most:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
