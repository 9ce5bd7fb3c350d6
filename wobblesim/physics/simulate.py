"""Many trials of one robot at once: validate, lay out lanes, run the blocks on threads, read off the outcome."""

from __future__ import annotations

import functools
import itertools
import math
import operator
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wobblesim.physics.contract import Method, Muscles, State, System, rows, step, system_of
from wobblesim.physics.kernels import available_threads, kernel
from wobblesim.physics.lanes import LanesTag, any_lane, lanes, load, select, splat, store
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics, Scene
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait, clock, split_behaviours
from wobblesim.robot.morphology import Morphology

WATCH_EVERY = 16  # steps between two looks for diverged lanes
VECTOR_BYTES = 64  # one AVX-512 register, or two AVX2 registers
# A step on rows of half the width takes 2**-0.55 = 0.68 of the time: see benchmarks/.
NARROW_EXPONENT = 0.55


@dataclass(frozen=True, eq=False)
class Trials:
    """What came of each trial.

    Attributes
    ----------
    displacement : (n_trials,) float
        Of the mean of the centre's nodes along +x, body lengths; NaN if the trial diverged.
    status : (n_trials,) str
        ``ok``; ``limited``: a limiter of the integrator has acted; ``diverged``: a node went beyond the speed
        bound or stopped being a number.
    limited : (n_trials,) int
        Node-steps that a limiter has cut.
    diverged_at : (n_trials,) float
        When the divergence was found, s (looked for every 16 steps); NaN if it was not.
    inverted : (n_trials,) int
        Cells of the body inside out at the end; 0 for a diverged trial.
    positions : (n_frames, n_nodes, 2, n_trials) or None
        u; frame 0 is the start, NaN from the divergence on. None if not recorded.
    """

    displacement: NDArray[np.float64]
    status: NDArray[np.str_]
    limited: NDArray[np.int64]
    diverged_at: NDArray[np.float64]
    inverted: NDArray[np.int64]
    positions: NDArray[Any] | None


def simulate(
    body: Body,
    behaviours: ArrayLike,
    *,
    morphology: Morphology = Morphology(),
    scene: Scene = Scene(),
    physics: Physics = Physics(),
    gait: Gait = Gait(),
    duration: float,
    record_every: int | None = None,
    threads: int | None = None,
    width: int | None = None,
) -> Trials:
    """Try behaviours on one robot, each from the same start.

    A trial's bits depend on nothing but its own behaviour: not on the other trials, their number or order, nor
    on lane width or threads.

    Parameters
    ----------
    body : Body
        The adult.
    behaviours : (n_trials, 2 n_groups)
        Amplitudes (units of `Gait.max_amplitude`) of all motor groups, then their offsets in turns.
    morphology : Morphology
        Factors on the adult.
    scene : Scene
    physics : Physics
    gait : Gait
    duration : float
        s; rounded to a whole number of steps.
    record_every : int, optional
        Keep the positions of every such step.
    threads : int, optional
        At most this many; all that Numba may use if not given.
    width : int, optional
        Lanes a block; the fastest if not given.

    Returns
    -------
    Trials

    Raises
    ------
    ValueError
        If a shape, name or range is wrong, or the integrator refuses the step.
    """
    behaviours = _checked_behaviours(body, behaviours)
    n_steps = _checked_steps(duration, physics.dt)
    _check_counts(record_every=record_every, threads=threads, width=width)
    if physics.integrator not in INTEGRATORS:
        raise ValueError(f"no integrator named {physics.integrator!r}: there are {', '.join(INTEGRATORS)}")
    adapted = body.adapted(morphology)
    system = system_of(adapted, scene, morphology.gravity)
    threads = threads or available_threads()
    integrator = INTEGRATORS[physics.integrator]
    dtype = np.dtype(physics.precision)
    method = integrator.prepare(system, physics, dtype)
    signals = split_behaviours(behaviours, gait)
    ticks = clock(gait, physics.dt, 2 * n_steps + 1).astype(dtype)
    full = integrator.registers * VECTOR_BYTES // dtype.itemsize
    widths = [width] * -(-len(behaviours) // width) if width else block_widths(len(behaviours), threads, full)
    starts = itertools.accumulate(widths, initial=0)
    blocks = [_Block(lanes(dtype, w), signals, start) for w, start in zip(widths, starts, strict=False)]
    run = functools.partial(_run_block, system, method, ticks, n_steps, physics, record_every)
    if threads == 1 or len(blocks) == 1:
        outcomes = [run(block) for block in blocks]
    else:
        outcomes = list(_pool(threads).map(run, blocks))
    return _read_off(adapted, system, method, physics, n_steps, record_every, outcomes, len(behaviours))


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that wait for the next call: starting two takes 2 ms, as long as 200 steps of a block."""
    return ThreadPoolExecutor(threads, thread_name_prefix="wobblesim")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a forked process has no threads but its own


def _checked_behaviours(body: Body, behaviours: ArrayLike) -> NDArray[np.float64]:
    behaviours = np.asarray(behaviours, dtype=np.float64)
    if behaviours.ndim != 2 or behaviours.shape[1] != 2 * body.n_groups:
        raise ValueError(
            f"behaviours have shape {behaviours.shape}: they must have (n_trials, {2 * body.n_groups}), "
            f"an amplitude and an offset for each of the {body.n_groups} motor groups"
        )
    if len(behaviours) == 0:
        raise ValueError("there are no behaviours to try: give at least one")
    return behaviours


def _checked_steps(duration: float, dt: float) -> int:
    if not (math.isfinite(duration) and duration > 0):
        raise ValueError(f"duration is {duration}: it must be a finite time > 0 s")
    return max(1, round(duration / dt))


def _check_counts(**counts: int | None) -> None:
    for name, count in counts.items():
        if count is not None and (not isinstance(count, (int, np.integer)) or count < 1):
            raise ValueError(f"{name} is {count}: it must be a whole number from 1")


def block_widths(n_trials: int, threads: int, full: int) -> list[int]:
    """Lane widths of the blocks that take the shortest time for so many trials on so many threads.

    Whole rounds of full blocks, one a thread; what is left over in blocks as narrow as keeps all threads busy.
    """
    rounds, left = divmod(n_trials, full * threads)

    def cost(width: int) -> float:
        return math.ceil(math.ceil(left / width) / threads) * (width / full) ** NARROW_EXPONENT

    width = min((full, full // 2, full // 4), key=cost)
    return [full] * (rounds * threads) + [width] * math.ceil(left / width)


@dataclass(frozen=True, eq=False)
class _Block:
    """Some lanes of the trials: the last block repeats the last trial to fill its lanes."""

    tag: LanesTag
    signals: tuple[NDArray[Any], NDArray[Any]]
    start: int

    def lanes_of(self, part: NDArray[Any]) -> NDArray[Any]:
        """Rows of this block's lanes from ``part (n_groups, n_trials)``."""
        block = rows(len(part), self.tag)
        block[:] = part[:, np.minimum(np.arange(self.start, self.start + self.tag.width), part.shape[1] - 1)]
        return block


@dataclass(frozen=True, eq=False)
class _Outcome:
    """What one block of lanes leaves behind, rows in the integrator's node order."""

    state: State
    limited: NDArray[np.int64]
    diverged_step: NDArray[Any]
    frames: NDArray[Any] | None


def _run_block(
    system: System, method: Method, ticks: NDArray[Any], n_steps: int, physics: Physics, record_every: int | None,
    block: _Block,
) -> _Outcome:  # fmt: skip
    tag, order = block.tag, method.node_order
    state = State(*(rows(system.n_nodes, tag) for _ in range(4)))
    for target, source in zip(state, (*system.position.T, *system.velocity.T), strict=True):
        target[:] = source[order, None]
    rest = rows(len(system.rest), tag)
    rest[:] = system.rest[:, None]
    frames = None
    if record_every is not None:
        frames = rows((n_steps // record_every + 1) * 2 * system.n_nodes, tag)
    watch, counts = rows(2, tag), np.zeros(tag.width, np.int64)
    watch[1] = -1.0
    muscles, work = _muscles(system, block, ticks), method.workspace(tag, state)
    ahead, max_speed = tag.dtype.type(method.ahead), tag.dtype.type(physics.max_speed)
    advance(
        tag, method.constants, method.floor, method.friction, muscles, state, rest, work, watch, counts,
        frames, record_every or 1, n_steps, ahead, max_speed,
    )  # fmt: skip
    return _Outcome(state, counts, watch[1], frames)


def _muscles(system: System, block: _Block, ticks: NDArray[Any]) -> Muscles | None:
    if len(system.muscle_row) == 0:
        return None
    length, dtype = system.rest[system.muscle_row], block.tag.dtype
    sine, cosine = map(block.lanes_of, block.signals)
    return Muscles(
        row=system.muscle_row, group=system.muscle_group, length=length.astype(dtype),
        signed_length=(system.muscle_sign * length).astype(dtype), sine=sine, cosine=cosine, clock=ticks,
    )  # fmt: skip


@kernel
def advance(
    tag,
    constants,
    floor,
    friction,
    muscles,
    state,
    rest,
    work,
    watch,
    counts,
    frames,
    record_every,
    n_steps,
    ahead,
    max_speed,
):
    """Run one block of lanes through all steps.

    Written in place: `state`, `rest`, `work`; ``watch (2, width)``: node-steps limited since the last look, and the
    step at which a lane was found diverged (-1: never); ``counts (width,)``: node-steps limited in all;
    ``frames (n_frames 2 n_nodes, width)``: x and y of each node, or None.
    """
    if frames is not None:
        _record(tag, state, 0.0 * ahead, frames, 0)
    _drift(tag, state, ahead)
    for n in range(n_steps):
        step(tag, constants, floor, friction, muscles, state, rest, watch, work, n)
        if frames is not None and (n + 1) % record_every == 0:
            _record(tag, state, ahead, frames, (n + 1) // record_every)
        if (n + 1) % WATCH_EVERY == 0 or n + 1 == n_steps:
            _tally(watch, counts)
            if _all_diverged(tag, state, watch, n + 1, max_speed):
                break
    _drift(tag, state, -ahead)


@kernel
def _tally(watch, counts):
    """Move the node-steps limited since the last look into whole numbers: float32 counts to 2^24 only.

    A lane found diverged counts no further: how long its block still runs is its neighbours' affair.
    """
    for lane in range(len(counts)):
        if watch[1, lane] < 0:
            counts[lane] += int(watch[0, lane])
        watch[0, lane] = 0.0


@kernel
def _drift(tag, state, time):
    """Move every node with its velocity for a time."""
    for i in range(len(state.x)):
        store(tag, state.x, i, load(tag, state.x, i) + time * load(tag, state.vx, i))
        store(tag, state.y, i, load(tag, state.y, i) + time * load(tag, state.vy, i))


@kernel
def _record(tag, state, ahead, frames, frame):
    """Write a frame of positions, taken back from where the integrator keeps them ahead."""
    n_nodes = len(state.x)
    for i in range(n_nodes):
        row = 2 * (frame * n_nodes + i)
        store(tag, frames, row, load(tag, state.x, i) - ahead * load(tag, state.vx, i))
        store(tag, frames, row + 1, load(tag, state.y, i) - ahead * load(tag, state.vy, i))


@kernel
def _all_diverged(tag, state, watch, n, max_speed):
    """Note lanes with a node beyond the speed bound, or not a number, for the first time."""
    sound = load(tag, watch, 1) < 0.0
    was_sound = sound
    for i in range(len(state.x)):
        place = load(tag, state.x, i) + load(tag, state.y, i)
        sound = sound & (abs(load(tag, state.vx, i)) <= max_speed) & (abs(load(tag, state.vy, i)) <= max_speed)
        sound = sound & (place - place <= 0.0)  # neither infinite nor NaN
    store(tag, watch, 1, select(was_sound & ~sound, splat(tag, n), load(tag, watch, 1)))
    return not any_lane(sound)


def _read_off(
    body: Body, system: System, method: Method, physics: Physics, n_steps: int, record_every: int | None,
    outcomes: list[_Outcome], n_trials: int,
) -> Trials:  # fmt: skip
    node_row = np.argsort(method.node_order)
    x, y = (np.concatenate([getattr(o.state, name) for o in outcomes], axis=1)[node_row, :n_trials].astype(np.float64)
            for name in ("x", "y"))  # fmt: skip
    limited = np.concatenate([o.limited for o in outcomes])[:n_trials]
    step_found = np.concatenate([o.diverged_step for o in outcomes])[:n_trials].astype(np.int64)
    diverged = step_found >= 0
    place = _mean(x[body.center]) - _mean(system.position[body.center, 0])
    inverted = body.inversions(np.stack([x, y], axis=1)) if len(body.cells) else np.zeros(n_trials, np.int64)
    positions = None
    if record_every is not None:
        positions = np.concatenate([_frames_of(o, system.n_nodes) for o in outcomes], axis=-1)[
            :, node_row, :, :n_trials
        ]
        frame_step = np.arange(len(positions)) * record_every
        lost = diverged & (frame_step[:, None] >= step_found)
        positions[np.broadcast_to(lost[:, None, None, :], positions.shape)] = np.nan
    return Trials(
        displacement=np.where(diverged, np.nan, place / body.body_length),
        status=np.where(diverged, "diverged", np.where(limited > 0, "limited", "ok")),
        limited=limited,
        diverged_at=np.where(diverged, step_found * physics.dt, np.nan),
        inverted=np.where(diverged, 0, inverted),
        positions=positions,
    )


def _mean(values: NDArray[Any]) -> Any:
    """Mean over the first axis, added up in order: NumPy's own order depends on the number of columns."""
    return functools.reduce(operator.add, values) / len(values)


def _frames_of(outcome: _Outcome, n_nodes: int) -> NDArray[Any]:
    assert outcome.frames is not None
    return outcome.frames.reshape(-1, n_nodes, 2, outcome.frames.shape[1])
