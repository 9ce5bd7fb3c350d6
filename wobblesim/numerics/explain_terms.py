"""Which terms of a scene are compiled in, and what each of them costs here and now.

A term without effect is None in the integrator's constants, and None is compiled to nothing. What a term costs is
timed on two kernels that move the robot alike: one with the term, too weak to move anything, and one without it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from wobblesim.learning.run import Setup
from wobblesim.physics.contract import Method, System, system_of
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Floor
from wobblesim.physics.simulate import Trials, full_block, simulate

FAINT = 1e-150
"""Weak beyond notice, and yet not left out; its products in float64 are no subnormal numbers, which are slow."""
NEARLY_ELASTIC = 1 - 1e-12
"""Restitution of the weakest dashpot of a compliant floor."""

RECORDED_EVERY = 10  # steps
TINY = 1e-7  # s
TIMED = 0.01  # s: length of a timed call; the least of many short ones says more than that of few long ones
MOST_STEPS = 500  # of a timed call: without damping a robot lasts no longer
LEAST_ROUNDS = 5

IN, LEFT_OUT, NO_CODE = "in", "left out", "no code"


@dataclass(frozen=True)
class Term:
    """One term of a scene.

    Attributes
    ----------
    name : str
    state : str
        ``in``; ``left out``; ``no code``: the scene may have it, and the kernel is the same without.
    why : str
        What the scene says of it.
    cost : float or None
        µs a lane-step, with the term minus without it; None where it has no code, or could not be timed.
    percent : float or None
        Of the lane-step of the scene as it is.
    """

    name: str
    state: str
    why: str
    cost: float | None
    percent: float | None


@dataclass(frozen=True)
class Costs:
    """The terms of one scene, timed on one thread in full blocks.

    Attributes
    ----------
    lane_step : float
        µs, of the scene as it is.
    noise : float
        µs: how far two timings of one kernel lie apart; a smaller cost is none.
    lanes : int
        Robots in a block.
    terms : tuple of Term
    """

    lane_step: float
    noise: float
    lanes: int
    terms: tuple[Term, ...]


def system_and_method(setup: Setup) -> tuple[System, Method]:
    """What a setup's adult becomes for its integrator; ValueError if that refuses the step."""
    system = system_of(setup.body, setup.scene, 1.0)
    physics = setup.physics
    return system, INTEGRATORS[physics.integrator].prepare(system, physics, np.dtype(physics.precision))


def specialisation(setup: Setup) -> tuple[bool, ...]:
    """Which of the arguments of the compiled step are None: setups that differ here have different kernels."""
    # the kernels are the same for all steps, and this one is refused by no integrator
    system, method = system_and_method(replace(setup, physics=replace(setup.physics, dt=TINY)))
    left_out = [constant is None for constant in (*method.constants, method.floor, method.friction)]
    return (*left_out, len(system.muscle_row) == 0)


# --- a setup without a term, and with a faint one ----------------------------------------------------------------


def _body(setup: Setup, **changes: Any) -> Setup:
    return replace(setup, body=replace(setup.body, build=None, **changes))


def _gravity(setup: Setup, size: float) -> Setup:
    return replace(setup, scene=replace(setup.scene, gravity=size))


def _friction(setup: Setup, size: float) -> Setup:
    return _body(setup, friction=np.full(setup.body.n_nodes, size))


def _damping(setup: Setup, size: float) -> Setup:
    return _body(setup, damping_ratio=np.full(setup.body.n_springs, size))


def _restitution(setup: Setup, size: float) -> Setup:
    """A floor that rebounds with 0 (rigid) or 1 (compliant), or off it by next to nothing."""
    if setup.scene.floor is None:
        return setup
    is_rigid = INTEGRATORS[setup.physics.integrator].contact == "rigid"
    value = size if is_rigid else NEARLY_ELASTIC if size else 1.0
    return replace(setup, scene=replace(setup.scene, floor=replace(setup.scene.floor, restitution=value)))


def _floor(setup: Setup, size: float) -> Setup:
    """No floor, or the setup's own; one that has none is put on a floor with its lowest node."""
    scene = setup.scene
    if not size:
        return replace(setup, scene=replace(scene, floor=None))
    if scene.floor is not None:
        return setup
    position = setup.body.position - [0.0, setup.body.position[:, 1].min()]
    return replace(_body(setup, position=position), scene=replace(scene, floor=Floor()))


def _muscles(setup: Setup, size: float) -> Setup:
    """Muscles that do not move, or none."""
    if size:
        return replace(setup, gait=replace(setup.gait, max_amplitude=size))
    none = np.zeros(0, np.int64)
    return _body(setup, muscle_spring=none, muscle_group=none, muscle_sign=np.zeros(0), n_groups=0)


SIZED: dict[str, Callable[[Setup, float], Setup]] = {
    "gravity": _gravity,
    "floor": _floor,
    "friction": _friction,
    "restitution": _restitution,
    "damping": _damping,
    "muscles": _muscles,
}
"""For each term ``(setup, size) -> setup``: size 0 leaves the term out, `FAINT` has it compiled in."""


# --- what the scene says ---------------------------------------------------------------------------------------


def states(setup: Setup) -> dict[str, str]:
    """Of each term but recording whether it is compiled in."""
    return {name: _state(name, setup) for name in SIZED}


def _state(name: str, setup: Setup) -> str:
    if _has_code(name, setup):
        return LEFT_OUT if specialisation(setup) == specialisation(SIZED[name](setup, 0.0)) else IN
    return NO_CODE if _asked_for(name, setup) else LEFT_OUT


def _has_code(name: str, setup: Setup) -> bool:
    """Whether a term is code of its own in this scene: some is a part of other constants, or of the floor."""
    return specialisation(SIZED[name](setup, FAINT)) != specialisation(SIZED[name](setup, 0.0))


def _asked_for(name: str, setup: Setup) -> bool:
    """Whether a scene has a term, be it compiled in as code of its own or not."""
    return name == "damping" and bool(setup.body.damping_ratio.any())


def _why(setup: Setup) -> dict[str, str]:
    body, floor = setup.body, setup.scene.floor
    gx, gy = setup.scene.gravity_vector
    of_floor = "there is no floor" if floor is None else None
    return {
        "gravity": f"{gx:g}, {gy:g} u/s²" if gx else f"{-gy:g} u/s² down",
        "floor": of_floor or f"{INTEGRATORS[setup.physics.integrator].contact} contact",
        "friction": of_floor or f"coefficients {_range(body.friction)}",
        "restitution": of_floor or f"{floor and floor.restitution:g}",
        "damping": f"damping ratios {_range(body.damping_ratio)}",
        "muscles": f"{len(body.muscle_spring)} springs in {body.n_groups} groups",
        "recording": "a sweep keeps no positions",
    }


def _range(values: np.ndarray) -> str:
    least, most = values.min(initial=np.inf), values.max(initial=-np.inf)
    return f"{least:g}" if least == most else f"{least:g} to {most:g}"


# --- what it costs ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Clock:
    """Calls of `simulate` that are timed side by side: full blocks, one thread."""

    lanes: int
    blocks: int
    steps: int

    def call(self, setup: Setup, record_every: int | None = None) -> Trials:
        # A trial repeated with a smaller step would be timed twice, and one without damping may well leave the bounds.
        physics = replace(setup.physics, refinements=0, max_speed=None, max_strain=None, max_energy=None)
        behaviours = np.random.default_rng(0).random((self.lanes * self.blocks, 2 * setup.body.n_groups))
        return simulate(
            setup.body, behaviours, scene=setup.scene, physics=physics, gait=setup.gait,
            duration=self.steps * physics.dt, record_every=record_every, threads=1, width=self.lanes,
        )  # fmt: skip

    def microseconds(self, seconds: float) -> float:
        """Of a lane-step, from the time of a call."""
        return 1e6 * seconds / (self.lanes * self.blocks * self.steps)


def _clock(setup: Setup) -> _Clock:
    """As many steps as a trial has, or fewer, and as many blocks, as take the time that is wanted."""
    most = min(MOST_STEPS, max(1, round(setup.duration / setup.physics.dt)))
    short = _Clock(full_block(setup.physics), 1, min(100, most))
    short.call(setup)
    a_step = min(_time(lambda: short.call(setup)) for _ in range(3)) / short.steps
    steps = max(1, min(most, int(TIMED / a_step)))
    return _Clock(short.lanes, max(1, int(TIMED / (a_step * steps))), steps)


def _time(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def measure(setup: Setup, seconds: float) -> Costs:
    """Time every term of a setup's scene, kernels compiled first.

    Parameters
    ----------
    setup : Setup
    seconds : float
        About how long to time; compiling comes on top.

    Raises
    ------
    ValueError
        If the integrator refuses the step.
    """
    clock = _clock(setup)
    best, noise = _interleaved(_calls(setup, clock), seconds)
    scene, state, why = best["scene"], states(setup) | {"recording": LEFT_OUT}, _why(setup)
    costs = {name: best.get((name, FAINT), np.nan) - best.get((name, 0.0), np.nan) for name in SIZED}
    costs["recording"] = best.get("recording", np.nan) - scene
    terms = tuple(
        Term(name, state[name], why[name], _known(clock.microseconds(cost)), _known(100 * cost / scene))
        for name, cost in costs.items()
    )
    return Costs(clock.microseconds(scene), clock.microseconds(noise), clock.lanes, terms)


def _calls(setup: Setup, clock: _Clock) -> dict[Hashable, Callable[[], Trials]]:
    """What is timed: the scene, the scene recorded, and of each term that is code of its own a faint one and none."""
    calls: dict[Hashable, Callable[[], Trials]] = {
        "scene": partial(clock.call, setup),
        "recording": partial(clock.call, setup, RECORDED_EVERY),
    }
    for name, sized in SIZED.items():
        if _has_code(name, setup):
            calls |= {(name, size): partial(clock.call, sized(setup, size)) for size in (0.0, FAINT)}
    return calls


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _works(call: Callable[[], Trials]) -> bool:
    """Whether the integrator takes the step, and no trial diverges: one that ends early has no time of its own."""
    try:
        return not (call().status == "diverged").any()
    except ValueError:
        return False


def _interleaved(calls: Mapping[Hashable, Callable[[], Trials]], seconds: float) -> tuple[dict[Hashable, float], float]:
    """Least time of each call, of sound ones only, and how far the least of even and of odd rounds lie apart."""
    sound = {name: call for name, call in calls.items() if name == "scene" or _works(call)}
    times: dict[Hashable, list[float]] = {name: [] for name in sound}
    # In a new order each round: a call that records leaves the caches full of frames to the one that comes next.
    names, rng, end = list(sound), np.random.default_rng(0), time.perf_counter() + seconds
    while len(times["scene"]) < LEAST_ROUNDS or time.perf_counter() < end:
        for place in rng.permutation(len(names)):
            times[names[place]].append(_time(sound[names[place]]))
    noise = float(np.median([abs(min(each[::2]) - min(each[1::2])) for each in times.values()]))
    return {name: min(each) for name, each in times.items()}, noise


def alike(setup: Setup) -> tuple[Hashable, ...]:
    """Setups of equal keys have the same kernels on bodies of the same size: their lane-steps cost the same."""
    physics, body = setup.physics, setup.body
    sizes = (body.n_nodes, body.n_springs, len(body.muscle_spring), body.n_groups)
    return physics.integrator, physics.precision, physics.iterations, sizes, specialisation(setup)
