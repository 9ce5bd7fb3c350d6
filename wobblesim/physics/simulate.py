"""Many trials of one robot at once: validate, lay out lanes, run the blocks on threads, read off the outcome."""

from __future__ import annotations

import functools
import itertools
import math
import operator
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wobblesim.physics.bounds import BOUNDS, Bounds, bounds_of, look
from wobblesim.physics.contract import Method, Muscles, State, System, plan_array, rows, step, system_of
from wobblesim.physics.kernels import available_threads, kernel
from wobblesim.physics.lanes import LanesTag, lanes, load, store
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics, Scene
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait, clock, split_behaviours
from wobblesim.robot.morphology import Morphology

WATCH_EVERY = 32  # steps between two looks for lanes beyond the trusted bounds: they take 0.5 % of the time
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
        ``ok``; ``limited``: a limiter of the integrator has acted; ``refined``: it left the trusted bounds, and stayed
        within them with a smaller step; ``diverged``: it left them with every step tried. A trial that is refined or
        diverged may have been limited too.
    dt : (n_trials,) float
        Step of the run that this is the outcome of, s: `Physics.dt`, or that halved as often as was tried.
    bound : (n_trials,) str
        Which of the bounds was left with `Physics.dt`: ``speed``, ``strain``, ``energy``, or ``number`` (a place is
        infinite or not a number); empty if none was.
    limited : (n_trials,) int
        Node-steps that a limiter has cut.
    diverged_at : (n_trials,) float
        When the last run was found beyond a bound, s (looked for every 32 steps); NaN if it was not.
    inverted : (n_trials,) int
        Cells of the body inside out at the end; 0 for a diverged trial.
    positions : (n_frames, n_nodes, 2, n_trials) or None
        u; frame 0 is the start, NaN from the divergence on. None if not recorded.
    """

    displacement: NDArray[np.float64]
    status: NDArray[np.str_]
    dt: NDArray[np.float64]
    bound: NDArray[np.str_]
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
    leave_out: bool = True,
) -> Trials:
    """Try behaviours on one robot, each from the same start.

    A trial that leaves the trusted bounds of `physics` is tried again with half the step, a quarter and so on, up to
    `Physics.refinements` times. A trial's bits depend on nothing but its own behaviour: not on the
    other trials, their number or order, nor on lane width or threads.

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
        Keep the positions of every such step of `Physics.dt`; of a refined trial, at the same times.
    threads : int, optional
        At most this many; all that Numba may use if not given.
    width : int, optional
        Lanes a block; the fastest if not given.
    leave_out : bool
        False compiles in also what has no effect in this scene (gravity 0, friction 0, muscles that rest ...): the same
        bits, more slowly.

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
    moves = bool(behaviours[:, : body.n_groups].any()) or not leave_out
    robot = _Robot(body, morphology, scene, gait, moves, leave_out)
    run = functools.partial(_run, robot, threads=threads or available_threads(), width=width)
    trials = run(behaviours, physics, n_steps, record_every)
    for halvings in range(1, physics.refinements + 1):
        left = np.flatnonzero(trials.status == "diverged")
        if len(left) == 0:
            break
        parts = 2**halvings
        every = None if record_every is None else record_every * parts
        finer = run(behaviours[left], replace(physics, dt=physics.dt / parts), n_steps * parts, every)
        trials = _refined(trials, left, finer)
    return trials


def _refined(trials: Trials, left: NDArray[np.int64], finer: Trials) -> Trials:
    """The trials with those of `left` as a run with a smaller step has them, but for the bound left first."""
    merged: dict[str, Any] = {name: None if value is None else value.copy() for name, value in vars(trials).items()}
    for name, value in merged.items():
        if value is not None and name != "bound":
            value[..., left] = getattr(finer, name)
    merged["status"][left] = np.where(finer.status == "diverged", "diverged", "refined")
    return Trials(**merged)


@dataclass(frozen=True)
class _Robot:
    """What moves, and where: all that decides a trial besides its behaviour and how motion is computed."""

    body: Body
    morphology: Morphology
    scene: Scene
    gait: Gait
    moves: bool  # whether some muscle does in some trial
    leave_out: bool  # whether terms without effect are left out


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A robot's arrays and an integrator made ready for them, none of which is ever written to."""

    body: Body
    system: System
    method: Method
    muscles: Muscles | None
    bounds: Bounds
    start: NDArray[Any]  # (4 n_nodes, 1): the state
    node_row: NDArray[np.int64]  # row of each node


# A wobble of 25 epochs comes back to the same robots, at up to four steps. What is kept holds its body, so that no
# other gets its id.
@functools.lru_cache(maxsize=256)
def _prepared(robot: _Robot, physics: Physics) -> _Prepared:
    body = robot.body.adapted(robot.morphology)
    system = system_of(body, robot.scene, robot.morphology.gravity, robot.leave_out)
    dtype = np.dtype(physics.precision)
    method = INTEGRATORS[physics.integrator].prepare(system, physics, dtype)
    bounds = bounds_of(system, method, physics, body.body_length, robot.gait.max_amplitude, dtype)
    order = method.node_order
    start = np.concatenate([*system.position[order].T, *system.velocity[order].T])[:, None].astype(dtype)
    return _Prepared(
        body, system, method, _muscles(system, dtype) if robot.moves else None, bounds, start, np.argsort(order)
    )


@functools.lru_cache(maxsize=4)
def _ticks(gait: Gait, dt: float, n_steps: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    ticks = clock(gait, dt, 2 * n_steps + 1).astype(dtype)
    ticks.setflags(write=False)
    return ticks


def _run(
    robot: _Robot, behaviours: NDArray[np.float64], physics: Physics, n_steps: int, record_every: int | None, *,
    threads: int, width: int | None,
) -> Trials:  # fmt: skip
    """Run every trial once."""
    prepared, dtype = _prepared(robot, physics), np.dtype(physics.precision)
    signals = split_behaviours(behaviours, robot.gait)
    ticks = _ticks(robot.gait, physics.dt, n_steps, dtype)
    full = full_block(physics)
    widths = [width] * -(-len(behaviours) // width) if width else block_widths(len(behaviours), threads, full)
    starts = itertools.accumulate(widths, initial=0)
    blocks = [_Block(lanes(dtype, w), signals, start) for w, start in zip(widths, starts, strict=False)]
    run = functools.partial(_run_block, prepared, ticks, n_steps, record_every)
    if threads == 1 or len(blocks) == 1:
        outcomes = [run(block) for block in blocks]
    else:
        outcomes = list(_pool(threads).map(run, blocks))
    return _read_off(prepared, physics, record_every, outcomes, len(behaviours))


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
    if not np.isfinite(behaviours).all():
        raise ValueError("a behaviour holds an infinity or something that is not a number")
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
    width = min((full, full // 2, full // 4), key=lambda width: _rest_cost(left, width, threads, full))
    return [full] * (rounds * threads) + [width] * math.ceil(left / width)


def call_cost(n_trials: int, threads: int, full: int) -> float:
    """Time that so many trials take, in that of a full block."""
    rounds, left = divmod(n_trials, full * threads)
    return rounds + min(_rest_cost(left, width, threads, full) for width in (full, full // 2, full // 4))


def _rest_cost(left: int, width: int, threads: int, full: int) -> float:
    return math.ceil(math.ceil(left / width) / threads) * (width / full) ** NARROW_EXPONENT


def full_block(physics: Physics) -> int:
    """Lanes of a full block."""
    return INTEGRATORS[physics.integrator].registers * VECTOR_BYTES // np.dtype(physics.precision).itemsize


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

    position: NDArray[Any]  # (2, n_nodes, width)
    tally: NDArray[np.int64]  # (3, width), see `advance`
    frames: NDArray[Any] | None


def _run_block(
    prepared: _Prepared, ticks: NDArray[Any], n_steps: int, record_every: int | None, block: _Block
) -> _Outcome:
    tag, system, method = block.tag, prepared.system, prepared.method
    n = system.n_nodes
    room = rows(6 * n + len(system.rest) + 2, tag)  # one array of all: making one takes 5 us
    state, place = State(*(room[i * n : (i + 1) * n] for i in range(4))), room[4 * n : 6 * n]
    rest, watch = room[6 * n : -2], room[-2:]
    room[: 4 * n] = prepared.start
    rest[:] = system.rest[:, None]
    frames = None
    if record_every is not None:
        frames = rows((n_steps // record_every + 1) * 2 * n, tag)
    tally = np.zeros((3, tag.width), np.int64)
    tally[1] = -1
    muscles, work = prepared.muscles, method.workspace(tag, state)
    if muscles is not None:
        sine, cosine = map(block.lanes_of, block.signals)
        muscles = muscles._replace(sine=sine, cosine=cosine, clock=ticks)
    advance(
        tag, method.constants, method.floor, method.friction, muscles, state, rest, work, prepared.bounds, place, watch,
        tally, frames, record_every or 1, n_steps,
    )  # fmt: skip
    return _Outcome(room[: 2 * n].reshape(2, n, tag.width), tally, frames)


def _muscles(system: System, dtype: np.dtype[Any]) -> Muscles | None:
    """What all blocks of lanes share; signals and clock come with the block."""
    if len(system.muscle_row) == 0:
        return None
    length, nothing = system.rest[system.muscle_row], np.empty((0, 0), dtype)
    return Muscles(
        row=plan_array(system.muscle_row), group=plan_array(system.muscle_group), length=length.astype(dtype),
        signed_length=(system.muscle_sign * length).astype(dtype), sine=nothing, cosine=nothing, clock=nothing,
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
    bounds,
    place,
    watch,
    tally,
    frames,
    record_every,
    n_steps,
):
    """Run one block of lanes through all steps.

    Written in place: `state`, `rest`, `work`; `place`, see `look`; ``watch (2, width)``: node-steps limited since the
    last look, and the bound that a lane has left; ``tally (3, width)`` int: node-steps limited in all, the step at
    which a lane was found beyond a bound (-1: never), and which bound; ``frames (n_frames 2 n_nodes, width)``: x and
    y of each node, or None.
    """
    ahead = bounds.ahead
    if frames is not None:
        _record(tag, state, 0.0 * ahead, frames, 0)
    _drift(tag, state, ahead)
    for n in range(n_steps):
        step(tag, constants, floor, friction, muscles, state, rest, watch, work, n)
        if frames is not None and (n + 1) % record_every == 0:
            _record(tag, state, ahead, frames, (n + 1) // record_every)
        if (n + 1) % WATCH_EVERY == 0 or n + 1 == n_steps:
            inside = look(tag, bounds, state, rest, place, watch)
            _count(watch, tally, n + 1)
            if not inside:
                break
    _drift(tag, state, -ahead)


@kernel
def _count(watch, tally, n):
    """Move what was seen since the last look into whole numbers: those of float32 end at 2^24.

    A lane found beyond a bound counts no further: how long its block still runs is its neighbours' affair.
    """
    for lane in range(tally.shape[1]):
        if tally[1, lane] < 0:
            tally[0, lane] += int(watch[0, lane])
            if watch[1, lane] > 0:
                tally[1, lane] = n
                tally[2, lane] = int(watch[1, lane])
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


def _read_off(
    prepared: _Prepared, physics: Physics, record_every: int | None, outcomes: list[_Outcome], n_trials: int
) -> Trials:
    body, node_row = prepared.body, prepared.node_row
    position = np.concatenate([o.position for o in outcomes], axis=-1)[:, node_row, :n_trials].astype(np.float64)
    limited, step, bound = np.concatenate([o.tally for o in outcomes], axis=-1)[:, :n_trials]
    diverged = step >= 0
    place = _mean(position[0, body.center]) - _mean(prepared.system.position[body.center, 0])
    inverted = body.inversions(position.swapaxes(0, 1)) if len(body.cells) else np.zeros(n_trials, np.int64)
    return Trials(
        displacement=np.where(diverged, np.nan, place / body.body_length),
        status=np.where(diverged, "diverged", np.where(limited > 0, "limited", "ok")),
        dt=np.full(n_trials, physics.dt),
        bound=np.array(BOUNDS)[bound],
        limited=limited,
        diverged_at=np.where(diverged, step * physics.dt, np.nan),
        inverted=np.where(diverged, 0, inverted),
        positions=None if record_every is None else _frames(outcomes, node_row, step, record_every),
    )


def _mean(values: NDArray[Any]) -> Any:
    """Mean over the first axis, added up in order: NumPy's own order depends on the number of columns."""
    return functools.reduce(operator.add, values) / len(values)


def _frames(
    outcomes: list[_Outcome], node_row: NDArray[np.int64], step: NDArray[np.int64], record_every: int
) -> NDArray[Any]:
    """Positions of all trials, NaN from the step on at which a trial was found beyond a bound (-1: never)."""
    parts = [o.frames.reshape(-1, len(node_row), 2, o.frames.shape[1]) for o in outcomes if o.frames is not None]
    positions = np.concatenate(parts, axis=-1)[:, node_row, :, : len(step)]
    lost = (step >= 0) & (np.arange(len(positions))[:, None] * record_every >= step)
    positions[np.broadcast_to(lost[:, None, None, :], positions.shape)] = np.nan
    return positions
