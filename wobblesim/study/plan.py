"""What is to be computed: settings become setups, wanted runs minus present ones become groups."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from wobblesim import config as settings
from wobblesim.learning.run import Setup
from wobblesim.learning.search import Search
from wobblesim.learning.wobble import Wobble
from wobblesim.physics.contract import system_of
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Floor, Physics, Scene
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology
from wobblesim.robot.starfish import starfish
from wobblesim.study.store import RunKey

LANES_OF_A_BLOCK = 16
"""Lanes that the physics takes at a time in float32, twice those in float64."""


class PlanError(Exception):
    """A condition that cannot be run; the message is one sentence with its remedy."""


# --- from settings to a setup --------------------------------------------------------------------------------------


def setup(parameters: settings.Parameters) -> Setup:
    """Build what a condition's settings describe.

    Raises
    ------
    ValueError
        If they describe nothing that can be simulated.
    """
    trial, learning = parameters.trial, parameters.learning
    return Setup(
        body=body(parameters.robot),
        scene=_scene(parameters.scene),
        physics=Physics(**dict(parameters.physics)),
        gait=Gait(period=trial.period, max_amplitude=trial.max_amplitude),
        duration=trial.duration,
        search=Search(**{key: value for key, value in dict(learning).items() if key != "epochs"}),
        wobble=Wobble(**dict(parameters.wobble)) if parameters.wobble else None,
        epochs=learning.epochs,
    )


@lru_cache(maxsize=64)  # most conditions of a study share their robot, and a body never changes
def body(robot: settings.StarfishRobot | settings.CustomRobot) -> Body:
    """Build the adult robot."""
    if isinstance(robot, settings.CustomRobot):
        return _custom_body(robot)
    numbers = {key: value for key, value in robot if key not in ("kind", "stiffness")}
    return starfish(**numbers, stiffness=dict(robot.stiffness))


def _custom_body(robot: settings.CustomRobot) -> Body:
    nodes, springs = robot.nodes, robot.springs
    return Body.from_arrays(
        [node.position for node in nodes],
        [spring.between for spring in springs],
        mass=[node.mass for node in nodes],
        friction=[node.friction for node in nodes],
        fixed=[node.fixed for node in nodes],
        velocity=[node.velocity for node in nodes],
        stiffness=[spring.stiffness for spring in springs],
        damping_ratio=[spring.damping_ratio for spring in springs],
        rest_length=_rest_lengths(robot),
        muscles=[(muscle.spring, muscle.group, muscle.sign) for muscle in robot.muscles],
        center=robot.center,
        body_length=robot.body_length,
    )


def _rest_lengths(robot: settings.CustomRobot) -> list[float]:
    """Rest lengths in u; where none is given, the distance of the nodes as placed."""
    places = [node.position for node in robot.nodes]
    return [
        math.dist(*(places[node] for node in spring.between)) if spring.rest_length is None else spring.rest_length
        for spring in robot.springs
    ]


def _scene(scene: settings.SceneSettings) -> Scene:
    return Scene(gravity=scene.gravity, floor=Floor(**dict(scene.floor)) if scene.floor else None)


# --- from conditions and seeds to groups of runs -------------------------------------------------------------------


@dataclass(frozen=True)
class Group:
    """Runs of one condition that are computed in lockstep.

    Attributes
    ----------
    condition : str
        Its id.
    seeds : tuple of int
    """

    condition: str
    seeds: tuple[int, ...]

    @property
    def runs(self) -> tuple[RunKey, ...]:
        """Condition id and seed of each run."""
        return tuple((self.condition, seed) for seed in self.seeds)

    def __str__(self) -> str:
        return f"{self.condition}, {written_seeds(self.seeds)}"


def written_seeds(seeds: Sequence[int]) -> str:
    """Say seeds in words: ``seed 3``, ``seeds 0..9`` or ``12 seeds from 0 to 40``."""
    first, last = seeds[0], seeds[-1]
    if len(seeds) == 1:
        return f"seed {first}"
    if list(seeds) == list(range(first, last + 1)):
        return f"seeds {first}..{last}"
    return f"{len(seeds)} seeds from {min(seeds)} to {max(seeds)}"


def group_size(threads: int) -> int:
    """How many seeds run in lockstep.

    With one seed for each lane of a block, on each thread, the lanes of a call fill whole blocks, as many on every
    thread, whether the whole population is tried or only the children. The fixed robot tries 15 a seed, the wobbling
    one 20, and no smaller number does both.
    """
    return LANES_OF_A_BLOCK * threads


def groups(missing: Iterable[RunKey], size: int, begun: Collection[Group] = ()) -> list[Group]:
    """Put missing runs into groups: those begun as they are, the others by `size` seeds.

    All conditions run the first seeds before any runs the next ones, so that a sweep stopped half-way has paired runs.

    Parameters
    ----------
    missing : iterable of (str, int)
        Condition id and seed, in the order wanted.
    size : int
    begun : collection of Group
        Groups with a checkpoint. One that would run a seed which is not missing and not present was begun for another
        command: leave it out.
    """
    of_begun = {run for group in begun for run in group.runs}
    seeds: dict[str, list[int]] = {}
    for run in missing:
        if run not in of_begun:
            seeds.setdefault(run[0], []).append(run[1])
    rounds = range(0, max(map(len, seeds.values()), default=0), size)
    fresh = [
        Group(condition, tuple(mine[start : start + size]))
        for start in rounds
        for condition, mine in seeds.items()
        if mine[start : start + size]
    ]
    return [*begun, *fresh]


@dataclass(frozen=True)
class Study:
    """A sweep as data: its conditions, by id, and its seeds.

    Attributes
    ----------
    conditions : dict of str to Parameters
        In the order of the configuration.
    seeds : tuple of int
    """

    conditions: Mapping[str, settings.Parameters]
    seeds: tuple[int, ...]

    @cached_property
    def setups(self) -> dict[str, Setup]:
        """What each condition simulates.

        Raises
        ------
        PlanError
            If one cannot be simulated.
        """
        built = {}
        for condition, parameters in self.conditions.items():
            try:
                built[condition] = setup(parameters)
                _check_step(built[condition])
            except ValueError as error:
                raise PlanError(f"condition {condition}: {error}") from error
        return built

    @property
    def runs(self) -> list[RunKey]:
        """All runs wanted: condition by condition, seed by seed."""
        return [(condition, seed) for condition in self.conditions for seed in self.seeds]

    @property
    def written(self) -> dict[str, dict[str, Any]]:
        """The settings of each condition as they are stored."""
        return {name: parameters.model_dump(mode="json") for name, parameters in self.conditions.items()}


def study(config: settings.SweepConfig) -> Study:
    """Lay out a sweep."""
    return Study({condition.id: condition.parameters for condition in settings.expand(config)}, config.seeds)


def _check_step(setup: Setup) -> None:
    """Have an integrator that is not stable at every step refuse it now, for each extreme of the wobble.

    Raises
    ------
    ValueError
        If it does.
    """
    integrator = INTEGRATORS[setup.physics.integrator]
    if integrator.stable_when_stiff:
        return
    for morphology in _extremes(setup):
        system = system_of(setup.body.adapted(morphology), setup.scene, morphology.gravity)
        integrator.prepare(system, setup.physics, np.dtype(setup.physics.precision))


def _extremes(setup: Setup) -> set[Morphology]:
    """The adult, and the robots with the least and the greatest factor of the wobble."""
    if setup.wobble is None:
        return {Morphology()}
    factors = setup.wobble.factor(np.arange(setup.epochs))
    return {Morphology(), *(setup.morphology(int(epoch)) for epoch in (factors.argmin(), factors.argmax()))}


def steps(setup: Setup) -> int:
    """Time steps of a trial."""
    return max(1, round(setup.duration / setup.physics.dt))


def lane_steps(setup: Setup, since: int = 0) -> int:
    """Time steps of all trials of a run from epoch `since` on, at most (what is tried again with a smaller step apart).

    A kept behaviour is not tried again while the morphology rests; a wobble is taken to change it in every epoch up to
    its end.
    """
    search = setup.search
    still = search.population - search.parents
    changing = setup.wobble.end + 1 if setup.wobble else 1
    whole_populations = max(0, min(setup.epochs, changing) - since)
    return ((setup.epochs - since) * still + whole_populations * search.parents) * steps(setup)
