"""Stiff and violent scenes with a known outcome: heavy chains, fast impacts, starts inside the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import expm

from wobblesim.numerics.stability_energy import energy, largest_rise, velocities
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Floor, Physics, Scene
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.robot.body import Body
from wobblesim.robot.starfish import starfish

Floats = NDArray[np.float64]

# --- the hanging chain ---------------------------------------------------------------------------------------------

LINK = 10.0  # u
STATIC_STRETCH = 0.01  # of the chain's length
END_MASSES = (1.0, 10.0, 100.0, 1e3, 1e4)


@dataclass(frozen=True)
class Chain:
    """A vertical chain of critically damped springs below a fixed node, released unstretched.

    Its stiffness, the same in all springs, is such that its own weight stretches it by `STATIC_STRETCH`.
    """

    end_mass: float
    nodes: int = 40

    @property
    def mass(self) -> Floats:
        """Of the free nodes ``(nodes,)``, from the top."""
        return np.append(np.ones(self.nodes - 1), self.end_mass)

    @property
    def length(self) -> float:
        """u, unstretched."""
        return LINK * self.nodes

    @property
    def static(self) -> float:
        """Stretch of the whole chain at rest, u."""
        return STATIC_STRETCH * self.length

    def stiffness(self, gravity: float) -> float:
        """Of every spring: the loads of all springs over the static stretch."""
        return float(gravity * self.mass[::-1].cumsum().sum() / self.static)

    def body(self, gravity: float) -> Body:
        """The chain; it has no muscles."""
        position = np.stack([np.zeros(self.nodes + 1), -LINK * np.arange(self.nodes + 1)], axis=1)
        return Body.from_arrays(
            position, [(i, i + 1) for i in range(self.nodes)], mass=np.append(1.0, self.mass),
            fixed=np.arange(self.nodes + 1) == 0, stiffness=self.stiffness(gravity),
        )  # fmt: skip

    def motion(self, gravity: float, frames: int, interval: float) -> Floats:
        """Exact stretch ``(frames,)`` at multiples of an interval, u: along its line the chain is linear."""
        n, m, k = self.nodes, self.mass, self.stiffness(gravity)
        above = np.append(np.inf, m[:-1])
        c = 2.0 * np.sqrt(k / (1.0 / above + 1.0 / m))
        link = np.eye(n) - np.eye(n, k=-1)  # stretches of the springs from the nodes' displacements, down positive
        pull = link.T / m[:, None]
        generator = np.block([[np.zeros((n, n)), np.eye(n)], [-k * pull @ link.T.T, -(pull * c) @ link]])
        rest = np.append(np.linalg.solve(link, (gravity * m[::-1].cumsum())[::-1] / k), np.zeros(n))
        step, away = expm(interval * generator), -rest
        stretch = np.empty(frames)
        for i in range(frames):
            stretch[i] = away[n - 1] + rest[n - 1]
            away = step @ away
        return stretch


def chain(end_mass: float, physics: Physics, seconds: float = 20.0, gravity: float = 100.0) -> dict[str, Any]:
    """Let a chain fall into its springs and compare its stretch with the exact motion (ST-3)."""
    made = Chain(end_mass)
    every = max(1, round(0.02 / physics.dt))
    trials = simulate(
        made.body(gravity), np.zeros((1, 0)), scene=Scene(gravity=gravity, floor=None), physics=physics,
        duration=seconds, record_every=every,
    )  # fmt: skip
    assert trials.positions is not None
    stretch = -trials.positions[:, -1, 1, 0].astype(np.float64) - made.length
    exact = made.motion(gravity, len(stretch), every * physics.dt)
    late = slice(len(stretch) // 2, None)
    return {
        "end_mass": end_mass, **_conditions(physics), "status": str(trials.status[0]),
        "omega_h": 2.0 * math.sqrt(made.stiffness(gravity)) * physics.dt,
        "peak": stretch.max() / made.static, "exact_peak": exact.max() / made.static,
        "final": stretch[late].mean() / made.static, "exact_final": exact[late].mean() / made.static,
        "path_error": np.abs(stretch - exact).max() / made.static,
    }  # fmt: skip


def chains(
    settings: Sequence[Physics], end_masses: Sequence[float] = END_MASSES, seconds: float = 20.0
) -> pd.DataFrame:
    """One row a setting and end mass."""
    return pd.DataFrame([chain(mass, physics, seconds) for physics in settings for mass in end_masses])


def _conditions(physics: Physics) -> dict[str, Any]:
    return {"integrator": physics.integrator, "precision": physics.precision, "dt": physics.dt}


# --- fast impacts --------------------------------------------------------------------------------------------------

SPEEDS = (1e2, 1e3, 1e4, 1e5)
PHASES = 16  # of the step in which a node touches down
DEEP = 5.0  # u; a node that ends deeper has gone through the floor: one pressed in passing is less than half as deep


def documented_depth(speed: float, floor: Floor, dt: float, gravity: float = 100.0) -> float:
    """How deep a node may go, u: the compliant floor's depth (docs/physics.md), and the way of one step.

    A method sees a contact at the end of the step in which it happens, `speed` times dt late at worst; a rigid floor
    has no depth of its own, that is all there is.
    """
    rest = gravity / floor.stiffness
    return rest + math.sqrt(rest**2 + speed**2 / floor.stiffness) + speed * dt


def impact(speed: float, physics: Physics) -> dict[str, Any]:
    """Throw nodes straight down that touch the floor in different phases of the step (CF-7)."""
    floor, h = Floor(), physics.dt
    start = speed * h * (np.arange(PHASES) + 0.5) / PHASES
    body = Body.from_arrays(np.stack([np.arange(PHASES), start], axis=1), velocity=[0.0, -speed])
    # `impulse` cuts moves to 2 u a step, and has to get down first.
    trials, x = _recorded(body, Scene(floor=floor), _fast(physics, speed), seconds=0.5 + 0.6 * h * start.max())
    y = x[:, :, 1]
    in_the_air = (y[1:] > 0) & (y[:-1] > 0)
    rebound = np.where(in_the_air, np.diff(y, axis=0) / h, 0.0).max(axis=0) / speed
    return _impact("nodes", speed, physics, trials, y) | {
        "documented": documented_depth(speed, floor, h) if _is_compliant(physics) else speed * h,
        "least_rebound": float(rebound.min()), "largest_rebound": float(rebound.max()), "rise": math.nan,
    }  # fmt: skip


def robot_impact(speed: float, physics: Physics, seconds: float = 2.0) -> dict[str, Any]:
    """Throw the starfish straight down, motors off (CF-7)."""
    built, scene = starfish(), Scene()
    body = replace(built, velocity=np.broadcast_to([0.0, -speed], built.position.shape).copy())
    trials, x = _recorded(body, scene, _fast(physics, speed), seconds)
    nothing = dict.fromkeys(("documented", "least_rebound", "largest_rebound"), math.nan)
    rise = _largest_rise(body, x, scene, physics)
    return _impact("starfish", speed, physics, trials, x[:, :, 1]) | nothing | {"rise": rise}


def _fast(physics: Physics, speed: float) -> Physics:
    """Bounds that the scene itself does not meet: what is looked for here is the floor's answer."""
    return replace(physics, max_speed=100.0 * speed)


def _impact(name: str, speed: float, physics: Physics, trials: Trials, y: Floats) -> dict[str, Any]:
    return {
        "body": name, "speed": speed, **_conditions(physics), "status": str(trials.status[0]),
        "deepest": -float(np.nanmin(y)), "through": int(np.count_nonzero(y[-1] < -DEEP)),
    }  # fmt: skip


def impacts(settings: Sequence[Physics], speeds: Sequence[float] = SPEEDS) -> pd.DataFrame:
    """One row a body, setting and speed."""
    tried = (impact, robot_impact)
    return pd.DataFrame([throw(speed, physics) for throw in tried for physics in settings for speed in speeds])


def _recorded(body: Body, scene: Scene, physics: Physics, seconds: float) -> tuple[Trials, Floats]:
    """A trial with motors off, and its positions (steps + 1, nodes, 2)."""
    motors_off = np.zeros((1, 2 * body.n_groups))
    trials = simulate(body, motors_off, scene=scene, physics=physics, duration=seconds, record_every=1)
    assert trials.positions is not None
    return trials, trials.positions[..., 0].astype(np.float64)


def _is_compliant(physics: Physics) -> bool:
    return INTEGRATORS[physics.integrator].contact == "compliant"


def _largest_rise(body: Body, x: Floats, scene: Scene, physics: Physics) -> float:
    floor = scene.floor if _is_compliant(physics) else None
    v = velocities(physics.integrator, x, body.velocity, physics.dt)
    return largest_rise(energy(body, x, v, scene.gravity_vector, floor))


# --- starts inside the floor -----------------------------------------------------------------------------------------

DEPTHS = (0.1, 1.0, 40.0, 400.0)


def exit_speed(depth: float, floor: Floor) -> float:
    """Speed at which the compliant floor throws out a node released at rest inside it, u/s; without gravity.

    The floor holds the energy k depth²/2, worth a speed of ``sqrt(kappa) depth``. Its dashpot takes from that, on the
    way out, the factor sqrt(restitution): a rebound is the way in and the way out, alike.
    """
    return math.sqrt(floor.restitution * floor.stiffness) * depth


def start_inside(depth: float, physics: Physics, seconds: float = 2.0) -> list[dict[str, Any]]:
    """Release a node and the starfish at rest, their lowest node so deep inside the floor (CF-8)."""
    scene, floor, adult = Scene(), Floor(), starfish()
    node = Body.from_arrays([(0.0, -depth)])
    robot = replace(adult, position=adult.position - [0.0, depth])
    return [
        {"body": name} | _released(body, depth, scene, floor, physics, seconds)
        for name, body in (("node", node), ("starfish", robot))
    ]


def _released(body: Body, depth: float, scene: Scene, floor: Floor, physics: Physics, seconds: float) -> dict[str, Any]:
    bounded, _ = _recorded(body, scene, physics, seconds)
    trials, x = _recorded(body, scene, _fast(physics, max(100.0, exit_speed(depth, floor))), seconds)
    y, compliant = x[:, :, 1], _is_compliant(physics)
    out = (y[1:] > 0) & (y[:-1] > 0)
    return {
        "depth": depth, **_conditions(physics), "status": str(bounded.status[0]), "unbounded": str(trials.status[0]),
        "exit": float(np.where(out, np.diff(y, axis=0) / physics.dt, 0.0).max()),
        "law": exit_speed(depth, floor) if compliant else 0.0,
        "energy_bound": math.sqrt(floor.stiffness) * depth if compliant else 0.0,
        "fall": math.sqrt(2.0 * -scene.gravity_vector[1] * depth), "through": int(np.count_nonzero(y[-1] < -DEEP)),
        "rise": _largest_rise(body, x, scene, physics) if compliant else math.nan,
    }  # fmt: skip


def starts_inside(settings: Sequence[Physics], depths: Sequence[float] = DEPTHS) -> pd.DataFrame:
    """One row a body, setting and depth."""
    return pd.DataFrame([row for physics in settings for depth in depths for row in start_inside(depth, physics)])
