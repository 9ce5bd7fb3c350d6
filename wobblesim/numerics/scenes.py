"""The scenes on which integrators are compared, from a spring with a closed form to the gait itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wobblesim.physics.scene import Scene
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology
from wobblesim.robot.starfish import starfish

Floats = NDArray[np.float64]

SPACE = Scene(gravity=0.0, floor=None)
MORPHOLOGIES = {
    "adult": Morphology(),
    "mass 0.5": Morphology(mass=0.5),
    "mass 1.5": Morphology(mass=1.5),
    "stiffness 0.5": Morphology(stiffness=0.5),
    "size 0.7": Morphology(size=0.7),
}
"""What the gait is tried on: the adult, and corners of what the paper wobbles."""


@dataclass(frozen=True, eq=False)
class Case:
    """One body, and what it is asked to do.

    Attributes
    ----------
    name : str
        Which of a scene's cases.
    body : Body
    behaviours : (n_trials, 2 n_groups)
    scene : Scene
    gait : Gait
    morphology : Morphology
    duration : float
        s.
    frame : float
        Time between two recorded frames, s: a multiple of every step that is tried.
    """

    name: str
    body: Body
    behaviours: Floats
    scene: Scene
    gait: Gait
    morphology: Morphology
    duration: float
    frame: float

    @property
    def times(self) -> Floats:
        """Times of the recorded frames, (n_frames,) s."""
        return np.arange(round(self.duration / self.frame) + 1, dtype=np.float64) * self.frame

    @property
    def has_floor(self) -> bool:
        """Whether there is contact, and with it a law of contact."""
        return self.scene.floor is not None


def oscillator(short: bool) -> list[Case]:
    """A mass on a spring of 6 rad/s and damping ratio 0.1, released 1 u from rest."""
    length, omega = 10.0, 6.0
    body = Body.from_arrays(
        [[0.0, 0.0], [length + 1.0, 0.0]], [(0, 1)], fixed=[True, False], stiffness=omega**2, damping_ratio=0.1,
        rest_length=length, body_length=length,
    )  # fmt: skip
    return [_passive("oscillator", body, SPACE, 2.0 if short else 5.0)]


def chain(short: bool) -> list[Case]:
    """Twenty springs of 2 u with masses of 1 and one of 100 at the end, let go unstretched, 30° from the vertical."""
    n, length, angle = 20, 2.0, math.radians(30.0)
    along = np.array([math.sin(angle), -math.cos(angle)])
    mass = np.ones(n + 1)
    mass[-1] = 100.0
    body = Body.from_arrays(
        length * np.arange(n + 1)[:, None] * along, [(i, i + 1) for i in range(n)], mass=mass,
        fixed=np.arange(n + 1) == 0, stiffness=100_000.0, damping_ratio=0.1, center=[n], body_length=n * length,
    )  # fmt: skip
    return [_passive("chain", body, Scene(floor=None), 0.4 if short else 2.0)]


def flight(short: bool) -> list[Case]:
    """The starfish moving its arms in free flight."""
    body = starfish()
    behaviours = _behaviours(body, 1 if short else 4)
    return [Case("adult", body, behaviours, SPACE, Gait(), Morphology(), 0.2 if short else 1.0, 0.04)]


def drop(short: bool) -> list[Case]:
    """The starfish turned by 0.1 rad, its lowest node 10 u above the floor, let go; its arms hardly move."""
    body = _tilted(starfish(), 0.1, 10.0)
    behaviours = _behaviours(body, 4 if short else 16)
    return [Case("adult", body, behaviours, Scene(), Gait(max_amplitude=0.01), Morphology(), 1.0, 0.2)]


def gait(short: bool) -> list[Case]:
    """The gait for 5 s, before it has amplified small errors."""
    return _gaits(5.0, 0.2, ("adult", "mass 0.5") if short else tuple(MORPHOLOGIES), 16 if short else 64)


def long_gait(short: bool) -> list[Case]:
    """The gait for a whole trial of 60 s; 10 s in the short form."""
    return _gaits(10.0 if short else 60.0, 1.0, ("adult",) if short else tuple(MORPHOLOGIES), 16 if short else 64)


SCENES: dict[str, Callable[[bool], list[Case]]] = {
    "oscillator": oscillator,
    "chain": chain,
    "flight": flight,
    "drop": drop,
    "gait": gait,
    "long-gait": long_gait,
}
"""Each scene by name: a function of whether the short form is wanted."""


def _passive(name: str, body: Body, scene: Scene, duration: float) -> Case:
    return Case(name, body, np.zeros((1, 0)), scene, Gait(), Morphology(), duration, 0.04)


def _gaits(duration: float, frame: float, names: tuple[str, ...], n_trials: int) -> list[Case]:
    body = starfish()
    behaviours = _behaviours(body, n_trials)
    return [Case(n, body, behaviours, Scene(), Gait(), MORPHOLOGIES[n], duration, frame) for n in names]


def _behaviours(body: Body, n_trials: int) -> Floats:
    return np.random.default_rng(1).random((n_trials, 2 * body.n_groups))


def _tilted(body: Body, angle: float, height: float) -> Body:
    """A body turned about the origin, and raised until its lowest node is at a height."""
    c, s = math.cos(angle), math.sin(angle)
    position = body.position @ np.array([[c, s], [-s, c]])
    position[:, 1] += height - position[:, 1].min()
    return replace(body, position=position, build=None)
