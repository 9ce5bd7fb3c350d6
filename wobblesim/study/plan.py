"""What is to be computed: settings become setups, wanted runs minus present ones become groups."""

from __future__ import annotations

import heapq
import itertools
import math
import weakref
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel

from wobblesim import config as settings
from wobblesim.config.beside import Beside
from wobblesim.learning.run import Setup
from wobblesim.learning.search import Search
from wobblesim.learning.wobble import Wobble
from wobblesim.physics.contract import system_of
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Floor, Physics, Scene
from wobblesim.physics.simulate import call_cost, full_block
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology
from wobblesim.robot.starfish import starfish
from wobblesim.study.group import Group
from wobblesim.study.manifest import RunKey


class PlanError(Exception):
    """A condition that cannot be run; the message is one sentence with its remedy."""


# --- from settings to a setup --------------------------------------------------------------------------------------


class Once:
    """Makes something of each section of the settings once: the conditions of a study share sections."""

    def __init__(self) -> None:
        self._made: dict[tuple[Callable[..., Any], int], tuple[Any, Any]] = {}

    def __call__(self, make: Callable[[Any], Any], section: Any) -> Any:
        """What `make` makes of this very object."""
        # by identity, which holds as long as the section is kept: to hash a large robot takes longer than all else
        key = make, id(section)
        if key not in self._made:
            self._made[key] = section, make(section)
        return self._made[key][1]


def setup(parameters: settings.Parameters, once: Once | None = None) -> Setup:
    """Build what a condition's settings describe; setups built with the same `once` share what they have in common.

    Raises
    ------
    ValueError
        If they describe nothing that can be simulated.
    """
    once, trial, wobble = once or Once(), parameters.trial, parameters.wobble
    return Setup(
        body=once(body, parameters.robot),
        scene=once(_scene, parameters.scene),
        physics=once(_physics, parameters.physics),
        gait=once(_gait, trial),
        duration=trial.duration,
        search=once(_search, parameters.learning),
        wobble=once(_wobble, wobble) if wobble else None,
        epochs=parameters.learning.epochs,
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


def _physics(physics: settings.PhysicsSettings) -> Physics:
    return Physics(**dict(physics))


def _gait(trial: settings.TrialSettings) -> Gait:
    return Gait(period=trial.period, max_amplitude=trial.max_amplitude)


def _search(learning: settings.LearningSettings) -> Search:
    return Search(**{key: value for key, value in learning if key != "epochs"})


def _wobble(wobble: settings.WobbleSettings) -> Wobble:
    return Wobble(**dict(wobble))


# --- from conditions and seeds to groups of runs -------------------------------------------------------------------


MOST_LANES = 320
"""Lanes a thread in a call, at most: twenty full blocks fill it well, and a stop waits for the end of the call."""

CALL = 54.0
"""Time of a call of `simulate` besides its steps, in that of a step of a full block: 0.43 ms, see benchmarks/."""


def plan(study: Study, present: Collection[RunKey], begun: Collection[Group], workers: int, threads: int) -> Plan:
    """Put the missing runs into groups: those begun as they are, the others so that all workers finish together.

    Parameters
    ----------
    study : Study
    present : collection of (str, int)
        Runs that are there.
    begun : collection of Group
        Groups with a checkpoint. One that would run a seed which is not missing and not present was begun for another
        command: leave it out.
    workers, threads : int
        How many groups are computed at a time, and with how many threads each.
    """
    taken = {run for group in begun for run in group.runs}.union(present)
    missing = {}
    for condition in study.conditions:
        seeds = study.seeds_of(condition)
        if taken:
            seeds = tuple(seed for seed in seeds if (condition, seed) not in taken)
        if seeds:
            missing[condition] = seeds
    counts = Counter((Kind.of(study.setups[condition]), len(seeds)) for condition, seeds in missing.items())
    return Plan(tuple(begun), missing, group_size(counts, workers, threads))


@dataclass(frozen=True)
class Plan:
    """The runs to compute.

    Attributes
    ----------
    begun : tuple of Group
        To be gone on with.
    missing : mapping of str to tuple of int
        Seeds of all other runs, by condition.
    size : int
        Seeds of a group, at most.
    """

    begun: tuple[Group, ...]
    missing: Mapping[str, tuple[int, ...]]
    size: int

    def __iter__(self) -> Iterator[Group]:
        """The groups, those begun first.

        All conditions run the first seeds before any runs the next ones, so that a sweep stopped half-way has paired
        runs.
        """
        yield from self.begun
        counts = {len(seeds) for seeds in self.missing.values()}
        edges = {count: [*itertools.accumulate(shares(count, self.size), initial=0)] for count in counts}
        left = list(self.missing.items())
        for turn in itertools.count():
            left = [(condition, seeds) for condition, seeds in left if turn + 1 < len(edges[len(seeds)])]
            if not left:
                return
            for condition, seeds in left:
                first, last = edges[len(seeds)][turn : turn + 2]
                yield Group(condition, seeds[first:last])

    def __len__(self) -> int:
        """How many groups there are."""
        return len(self.begun) + sum(-(-len(seeds) // self.size) for seeds in self.missing.values())

    def work(self, study: Study) -> int:
        """Lane-steps to do, at most."""
        runs = Counter({condition: len(seeds) for condition, seeds in self.missing.items()})
        for group in self.begun:
            runs[group.condition] += len(group.seeds)
        return sum(count * lane_steps(study.setups[condition]) for condition, count in runs.items())


def shares(count: int, size: int) -> list[int]:
    """Lengths of the fewest parts of at most `size`, as equal as can be."""
    return [length for length, times in lengths(count, size) for _ in range(times)]


def lengths(count: int, size: int) -> list[tuple[int, int]]:
    """Each length of those parts, and how many have it, the longer first."""
    if not count:
        return []
    parts = -(-count // size)
    short, longer = divmod(count, parts)
    return [(length, times) for length, times in ((short + 1, longer), (short, parts - longer)) if times]


class Kind(NamedTuple):
    """What the time of a run depends on.

    Attributes
    ----------
    population, children : int
        Behaviours tried in an epoch while the robot changes, and while it does not.
    changing, resting : int
        Epochs of each.
    steps : int
        Of a trial.
    full : int
        Lanes of a full block.
    """

    population: int
    children: int
    changing: int
    resting: int
    steps: int
    full: int

    @classmethod
    def of(cls, setup: Setup) -> Kind:
        """The kind of a setup."""
        search, changing = setup.search, _changing(setup)
        return cls(
            search.population, search.population - search.parents, changing, setup.epochs - changing, steps(setup),
            full_block(setup.physics),
        )  # fmt: skip

    def cost(self, seeds: int, threads: int, call: float = CALL) -> float:
        """Time of a group of so many seeds, in that of a step of a full block; `call` is that of a call in itself."""
        whole, part = (call_cost(seeds * tried, threads, self.full) for tried in (self.population, self.children))
        return self.changing * (call + self.steps * whole) + self.resting * (call + self.steps * part)


def group_size(runs: Mapping[tuple[Kind, int], int], workers: int, threads: int) -> int:
    """How many seeds run in lockstep, at most, for all runs to be done first.

    Few seeds leave lanes of the last block empty; many leave workers without anything to do.

    Parameters
    ----------
    runs : mapping
        Of a kind and a number of missing runs, how many conditions have both.
    workers, threads : int
    """
    if not runs:
        return 1
    most = max(1, MOST_LANES * threads // max(kind.population for kind, _ in runs))
    sizes = range(1, min(most, max(count for _, count in runs)) + 1)
    # Of those that do as well to a hundredth, the largest: fewer calls, fewer checkpoints.
    spans = {size: makespan(runs, size, workers, threads) for size in sizes}
    return max(size for size in sizes if spans[size] <= 1.01 * min(spans.values()))


def makespan(runs: Mapping[tuple[Kind, int], int], size: int, workers: int, threads: int) -> float:
    """Time until all workers are done with the groups, in that of a step of a full block."""
    groups: Counter[float] = Counter()
    for (kind, count), conditions in runs.items():
        for seeds, times in lengths(count, size):
            groups[kind.cost(seeds, threads)] += conditions * times
    return span(groups, workers)


def span(groups: Mapping[float, int], workers: int) -> float:
    """Time until all workers are done with groups, the longest first.

    Parameters
    ----------
    groups : mapping
        Of a time, how many groups take so long.
    workers : int
    """
    total = sum(time * times for time, times in groups.items())
    if workers == 1 or not groups:
        return total
    if sum(groups.values()) > MANY_GROUPS * workers:
        return total / workers + max(groups) / 2  # the last group ends somewhere within the others' last
    busy = [0.0] * workers
    for time in sorted(Counter(groups).elements(), reverse=True):
        heapq.heapreplace(busy, busy[0] + time)
    return max(busy)


MANY_GROUPS = 50
"""Groups a worker from which on they are not dealt out one by one to find how long they take."""


def _refusal(condition: str, message: str) -> Exception:
    return PlanError(f"condition {condition}: {message}")


@dataclass(frozen=True)
class Study:
    """A sweep as data: its conditions, by id, and its seeds.

    Attributes
    ----------
    conditions : dict of str to Parameters
        In the order of the configuration.
    seeds : tuple of int
    part : mapping of str to tuple of int, optional
        The seeds of each condition that are a shard's; all of all if not given.
    refusal : callable
        Makes the error of a condition, by id, whose step its integrator refuses with a sentence.
    """

    conditions: Mapping[str, settings.Parameters]
    seeds: tuple[int, ...]
    part: Mapping[str, tuple[int, ...]] | None = None
    refusal: Callable[[str, str], Exception] = field(default=_refusal, compare=False, repr=False)

    @cached_property
    def setups(self) -> dict[str, Setup]:
        """What each condition simulates.

        Raises
        ------
        PlanError, ConfigError
            If one cannot be simulated.
        """
        built: dict[str, Setup] = {}
        once = Once()
        for condition, parameters in self.conditions.items():
            try:
                built[condition] = setup(parameters, once)
            except ValueError as error:
                raise _refusal(condition, str(error)) from error
        for condition in _doubtful(built):
            try:
                _check_step(built[condition])
            except ValueError as error:
                raise self.refusal(condition, str(error)) from error
        return built

    def seeds_of(self, condition: str) -> tuple[int, ...]:
        """The seeds wanted of a condition."""
        return self.seeds if self.part is None else self.part.get(condition, ())

    @property
    def n_runs(self) -> int:
        """How many runs are wanted."""
        return sum(len(self.seeds_of(condition)) for condition in self.conditions)

    def asks_for(self, run: RunKey) -> bool:
        """Whether a run is wanted."""
        return run[0] in self.conditions and run[1] in self._seed_sets[run[0]]

    @cached_property
    def _seed_sets(self) -> dict[str, frozenset[int]]:
        if self.part is None:
            return dict.fromkeys(self.conditions, frozenset(self.seeds))
        return {condition: frozenset(self.seeds_of(condition)) for condition in self.conditions}

    @cached_property
    def written(self) -> dict[str, dict[str, Any]]:
        """The settings of each condition as JSON has them, to be stored; what conditions share is the same object."""
        once = Once()
        return {
            name: {section: once(_as_json, value) for section, value in parameters}
            for name, parameters in self.conditions.items()
        }

    def shard(self, number: int, count: int) -> Study:
        """The part of the runs that is for one of `count` jobs, the first of which is 1.

        Runs stand in a row, condition by condition, and are cut where the work done before is a multiple of a
        `count`-th: the parts depend on nothing but the study, and most runs of a condition stay together.
        """
        ends = list(itertools.accumulate(len(self.seeds) * lane_steps(self.setups[name]) for name in self.conditions))
        part = {}
        for condition, end in zip(self.conditions, ends, strict=True):
            a_run = lane_steps(self.setups[condition])
            start = end - len(self.seeds) * a_run
            # a run belongs to the shard in which its first lane-step lies
            first, last = (-(-(ends[-1] * edge - start * count) // (a_run * count)) for edge in (number - 1, number))
            mine = self.seeds[max(first, 0) : max(last, 0)]
            if mine:
                part[condition] = mine
        return replace(self, part=part)


def _as_json(value: Any) -> Any:
    return value.model_dump(mode="json") if isinstance(value, BaseModel) else value


_studies: Beside[Study] = Beside()


def study(config: settings.SweepConfig) -> Study:
    """Lay out a sweep; once, after that the same study is returned."""
    known = _studies.of(config)
    if known is None:
        conditions = {condition.id: condition.parameters for condition in settings.expand(config)}
        of = weakref.ref(config)  # the study is kept beside the configuration, and must not keep it alive

        def refusal(condition: str, message: str) -> Exception:
            written = of()
            if written is None:
                return _refusal(condition, message)
            return settings.condition_error(written, condition, message, "physics.dt", "physics.integrator")

        _studies.keep(config, known := Study(conditions, config.seeds, refusal=refusal))
    return known


def _doubtful(setups: Mapping[str, Setup]) -> list[str]:
    """Conditions whose step an integrator might refuse, which is to be found out now.

    It takes some 10 ms each. So conditions of one robot are first taken together: a step that is good for the ends of
    all their sines together is good for each.
    """
    alike: dict[Hashable, list[str]] = {}
    for condition, setup in setups.items():
        if not INTEGRATORS[setup.physics.integrator].stable_when_stiff:
            dimensions = setup.wobble.dimensions if setup.wobble else ()
            alike.setdefault((setup.body, setup.scene, setup.physics, dimensions), []).append(condition)
    found = []
    for conditions in alike.values():
        ends = [end for name in conditions for end in _sine_ends(setups[name])]
        try:
            _prepare(setups[conditions[0]], {min(ends), max(ends)})
        except ValueError:
            found += conditions
    return found


def _sine_ends(setup: Setup) -> tuple[float, float]:
    """Least and greatest factor of the wobble's sine, whether or not an epoch meets them; the adult's 1 among them."""
    wobble = setup.wobble
    if wobble is None:
        return 1.0, 1.0
    bound = math.inf if wobble.upper_bound is None else wobble.upper_bound
    return wobble.least_factor(), max(1.0, min(wobble.mean + wobble.amplitude, bound))


def _check_step(setup: Setup) -> None:
    """Have the integrator refuse the step for the least and the greatest factor that an epoch meets.

    Raises
    ------
    ValueError
        If it does.
    """
    factors = setup.wobble.factor(np.arange(setup.epochs)) if setup.wobble else np.ones(1)
    _prepare(setup, {1.0, float(factors.min()), float(factors.max())})


def _prepare(setup: Setup, factors: Collection[float]) -> None:
    """Make the integrator ready for robots with these factors of the wobble; ValueError if it refuses the step."""
    dimensions = setup.wobble.dimensions if setup.wobble else ()
    for factor in factors:
        morphology = Morphology(**dict.fromkeys(dimensions, factor))
        system = system_of(setup.body.adapted(morphology), setup.scene, morphology.gravity)
        INTEGRATORS[setup.physics.integrator].prepare(system, setup.physics, np.dtype(setup.physics.precision))


def steps(setup: Setup) -> int:
    """Time steps of a trial."""
    return max(1, round(setup.duration / setup.physics.dt))


def lane_steps(setup: Setup, since: int = 0) -> int:
    """Time steps of all trials of a run from epoch `since` on, at most (what is tried again with a smaller step apart).

    A kept behaviour is not tried again while the morphology rests.
    """
    search = setup.search
    still = search.population - search.parents
    whole_populations = max(0, _changing(setup) - since)
    return ((setup.epochs - since) * still + whole_populations * search.parents) * steps(setup)


def _changing(setup: Setup) -> int:
    """Epochs that try the whole population: a wobble is taken to change the robot in every epoch up to its end."""
    return min(setup.epochs, setup.wobble.end + 1 if setup.wobble else 1)
