"""What a sweep may say: frozen pydantic models, one for each section of the YAML file.

The models hold plain data and know nothing about the simulator; ``wobblesim.study.plan`` turns them into bodies,
scenes and searches. Every number has a range and a unit, unknown keys are refused, and the checks that involve
several keys are made here too, so that a configuration which exists can be run. Units are those of the paper's
author: ``u`` for length (a section of the robot is 40 u high), seconds, and a mass unit.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    PlainSerializer,
    StrictBool,
    field_validator,
    model_validator,
)

from wobblesim.config.beside import Beside
from wobblesim.config.fields import (
    MAX_RUNS,
    NAME_RULE,
    SEED_RULE,
    Name,
    Override,
    Path,
    Real,
    Seeds,
    Values,
    Vector,
    Whole,
    check_id,
    first_double,
    number,
    refusal,
    shown,
    text,
)

MAX_CONDITIONS = 10_000
MAX_SWEPT_KEYS = 100
MAX_EPOCHS = 1_000_000
MAX_STEPS = 100_000_000
MIN_LENGTH = 1e-6
"""u; the square of a much smaller one is no number that can be divided by."""

Dimension = Literal["mass", "stiffness", "size", "gravity"]


class Section(BaseModel, frozen=True, extra="forbid", validate_default=False):
    """Base of all sections: frozen, no unknown keys, defaults described from the attributes."""


# --- robot ---------------------------------------------------------------------------------------------------------


class StarfishStiffness(Section, frozen=True):
    """Spring constants of the starfish robot."""

    diagonal: Real = number(100_000.0, "Stiffness of the two diagonals of a section", "mass unit/s²", gt=0, le=1e9)
    side: Real = number(3_000.0, "Stiffness of the two sides, the muscles", "mass unit/s²", gt=0, le=1e9)
    width: Real = number(12_000.0, "Stiffness of the spring across a section", "mass unit/s²", gt=0, le=1e9)
    center: Real = number(500_000.0, "Stiffness of the springs of the centre", "mass unit/s²", gt=0, le=1e9)
    tip: Real = number(500_000.0, "Stiffness of the two springs of a tip", "mass unit/s²", gt=0, le=1e9)


class StarfishRobot(Section, frozen=True):
    """The paper's robot: arms of sections around a regular polygon."""

    kind: Literal["starfish"] = Field(description="The paper's robot, built from the numbers below.")
    arms: Whole = number(6, "Number of arms, and of centre nodes", ge=3, le=64)
    sections: Whole = number(8, "Sections of an arm, the tip not counted", ge=1, le=200)
    height: Real = number(40.0, "Height of a section and of a tip", "u", ge=MIN_LENGTH, le=1e4)
    width: Real = number(30.0, "Width of a section", "u", ge=MIN_LENGTH, le=1e4)
    center_side: Real = number(30.0, "Side of the central polygon", "u", ge=MIN_LENGTH, le=1e4)
    groups_per_arm: Whole = number(2, "Motor groups of an arm; no more than its sections", ge=1, le=200)
    node_mass: Real = number(1.0, "Mass of every node", "mass unit", gt=0, le=1e6)
    friction: Real = number(0.5, "Coulomb friction coefficient of every node", ge=0, le=100)
    stiffness: StarfishStiffness = Field(default=StarfishStiffness(), description="Spring constants.")
    damping_ratio: Real = number(1.0, "Damping ratio of every spring (1 is critical)", ge=0, le=100)

    @property
    def least_height(self) -> float:
        """Height in u below which a first section, whose sides are ``height`` long, cannot be built.

        Its rise is taken to be a millionth of its width at least, for in a flatter one rounding decides.
        """
        return math.hypot((self.center_side - self.width) / 2, 1e-6 * max(self.center_side, self.width))

    @model_validator(mode="after")
    def _buildable(self) -> StarfishRobot:
        if self.groups_per_arm > self.sections:
            raise refusal(
                f"{self.groups_per_arm} motor groups cannot share {self.sections} sections; "
                f"use at most {self.sections} groups or more sections",
                ("groups_per_arm",),
                ("sections",),
            )
        if self.height <= self.least_height:
            raise refusal(
                f"sides of {self.height:g} u cannot join a base of {self.center_side:g} u to a width of "
                f"{self.width:g} u; use a height above {self.least_height:g}",
                ("height",),
                ("center_side",),
                ("width",),
            )
        return self


class Node(Section, frozen=True):
    """A point mass of a custom robot."""

    position: Vector = text(..., "Initial place [x, y] in u, y up from the floor", "two numbers [x, y] in u")
    mass: Real = number(1.0, "Mass", "mass unit", gt=0, le=1e6)
    friction: Real = number(0.5, "Coulomb friction coefficient", ge=0, le=100)
    fixed: StrictBool = Field(default=False, description="Whether the node never moves.")
    velocity: Vector = text((0.0, 0.0), "Initial velocity [vx, vy] in u/s", "two numbers [vx, vy] in u/s")


class Spring(Section, frozen=True):
    """A damped spring between two nodes of a custom robot."""

    between: tuple[Whole, Whole] = text(..., "The two nodes joined", "two node numbers [a, b], the first node is 0")
    stiffness: Real = number(..., "Spring constant", "mass unit/s²", gt=0, le=1e9)
    damping_ratio: Real = number(1.0, "Damping ratio (1 is critical)", ge=0, le=100)
    rest_length: Real | None = number(None, "Rest length, null: the length as built", "u", ge=MIN_LENGTH, le=1e6)


class Muscle(Section, frozen=True):
    """A spring whose rest length follows the signal of a motor group: L (1 + sign alpha)."""

    spring: Whole = number(..., "Number of the spring, the first is 0", ge=0, le=19_999)
    group: Whole = number(..., "Number of the motor group, the first is 0", ge=0, le=9_999)
    sign: Real = number(1.0, "Factor on the group's signal, -1 for the antagonist; not 0", ge=-10, le=10)

    @field_validator("sign")
    @classmethod
    def _acts(cls, sign: float) -> float:
        if sign == 0:
            raise refusal("a muscle of sign 0 does nothing; use 1, or -1 for the antagonist")
        return sign


class CustomRobot(Section, frozen=True):
    """Any robot made of nodes, springs and muscles."""

    kind: Literal["custom"] = Field(description="A robot given node by node and spring by spring.")
    nodes: tuple[Node, ...] = text(..., "Point masses", "a list of 2 to 5,000 nodes", min_length=2, max_length=5_000)
    springs: tuple[Spring, ...] = text(..., "Springs", "a list of 1 to 20,000 springs", min_length=1, max_length=20_000)
    muscles: tuple[Muscle, ...] = text(
        ..., "Springs that move", "a list of 1 to 20,000 muscles", min_length=1, max_length=20_000
    )
    center: tuple[Whole, ...] | None = text(
        None, "Nodes whose mean x is the robot's place, null: all nodes", "null or a list of node numbers", min_length=1
    )
    body_length: Real | None = number(
        None, "Unit of the performance, null: the extent of the nodes along x", "u", ge=MIN_LENGTH, le=1e6
    )

    @property
    def bounds(self) -> tuple[float, float]:
        """Largest size of a muscle's sign, and height in u of the lowest node that is free to move.

        Found once: thousands of conditions may have the same robot.
        """
        known = _bounds.of(self)
        if known is None:
            signs = (abs(muscle.sign) for muscle in self.muscles)
            known = max(signs), min((node.position[1] for node in self.nodes if not node.fixed), default=math.inf)
            _bounds.keep(self, known)
        return known

    @model_validator(mode="after")
    def _connected(self) -> CustomRobot:
        for i, spring in enumerate(self.springs):
            self._check_spring(i, *spring.between)
        for i, muscle in enumerate(self.muscles):
            _check_index(muscle.spring, len(self.springs), "spring", ("muscles", i, "spring"))
        for i, node in enumerate(self.center or ()):
            _check_index(node, len(self.nodes), "node", ("center", i))
        if self.center is not None and len(set(self.center)) < len(self.center):
            raise refusal("a node is listed twice; list each node once", ("center",))
        self._check_groups()
        return self

    def _check_spring(self, i: int, a: int, b: int) -> None:
        for end, node in enumerate((a, b)):
            _check_index(node, len(self.nodes), "node", ("springs", i, "between", end))
        if a == b:
            raise refusal(f"joins node {a} to itself; give two different nodes", ("springs", i, "between"))
        if math.dist(self.nodes[a].position, self.nodes[b].position) < MIN_LENGTH:
            raise refusal(
                f"joins nodes {a} and {b}, which are at the same place, so that it has no direction; move one of them",
                ("springs", i, "between"),
            )

    def _check_groups(self) -> None:
        double = first_double(muscle.spring for muscle in self.muscles)
        if double is not None:
            raise refusal(
                f"spring {self.muscles[double].spring} is a muscle already; a spring has one muscle",
                ("muscles", double, "spring"),
            )
        groups = {muscle.group for muscle in self.muscles}
        highest = max(groups)
        if len(groups) <= highest:
            missing = next(g for g in range(highest) if g not in groups)
            raise refusal(
                f"motor group {missing} has no muscle although there is a group {highest}; "
                "number the groups 0, 1, 2, ... without a gap",
                ("muscles",),
            )


_bounds: Beside[tuple[float, float]] = Beside()


def _check_index(index: int, count: int, noun: str, at: Path) -> None:
    if not 0 <= index < count:
        raise refusal(f"there is no {noun} {index}; the {noun}s are numbered 0 to {count - 1}", at)


Robot = Annotated[StarfishRobot | CustomRobot, Field(discriminator="kind")]

# --- world and trial -----------------------------------------------------------------------------------------------


class FloorSettings(Section, frozen=True):
    """The floor at y = 0."""

    restitution: Real = number(0.5, "Share of the normal speed kept at a rebound", ge=0, le=1)
    restitution_threshold: Real = number(
        1.0, "Speed below which a node does not rebound; for impulse only", "u/s", ge=0, le=1e6
    )
    stiffness: Real = number(
        10_000.0, "Stiffness of a contact, per unit of node mass; not for impulse", "1/s²", gt=0, le=1e9
    )


GRAVITY_RULE = "one number (downward) or [gx, gy], each from -10,000 to 10,000 u/s²"


def _gravity(value: Any) -> Any:
    """Accept one number (downward) or two ([gx, gy])."""
    if isinstance(value, list | tuple) and len(value) == 2:
        return tuple(map(_acceleration, value))
    return _acceleration(value)


def _acceleration(value: Any) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= 1e4:
        fault = "is out of range" if is_number else "is not an acceleration"
        raise refusal(f"{shown(value)} {fault}; allowed: {GRAVITY_RULE}")
    return float(value)


class SceneSettings(Section, frozen=True):
    """The world around the robot."""

    gravity: Annotated[float | Vector, BeforeValidator(_gravity, json_schema_input_type=float | Vector)] = text(
        100.0, "Gravity", GRAVITY_RULE
    )
    floor: FloorSettings | None = Field(
        default=FloorSettings(), description="The floor at y = 0; null for free flight."
    )


class PhysicsSettings(Section, frozen=True):
    """How the motion is computed."""

    integrator: Literal["midpoint", "impulse", "explicit"] = Field(
        default="midpoint",
        description="Integrator: midpoint (default), impulse (the paper's engine) or explicit (RK4).",
    )
    dt: Real = number(0.02, "Time step", "s", gt=0, le=1)
    precision: Literal["float32", "float64"] = Field(
        default="float32", description="Floating-point type of the simulation."
    )
    iterations: Whole = number(5, "Solver iterations a step, for impulse only", ge=1, le=1000)
    theta: Real = number(0.6, "Weight of the new position in the springs' forces, for midpoint only", ge=0.5, le=1)
    max_speed: Real | None = number(5e4, "Trusted bound on the speed of a node, null: no bound", "u/s", gt=0, le=1e9)
    max_strain: Real | None = number(
        20.0,
        "Trusted bound on the strain of a spring (change of length over rest length), null: no bound",
        gt=0,
        le=1e9,
    )
    max_energy: Real | None = number(
        20.0,
        "Trusted bound on the energy gained since the start, over that of the robot's weight and muscles, "
        "null: no bound",
        gt=0,
        le=1e9,
    )
    refinements: Whole = number(
        3,
        "How often a trial that leaves a bound is repeated with half the step before it counts as diverged",
        ge=0,
        le=10,
    )


class TrialSettings(Section, frozen=True):
    """One trial of one behaviour."""

    duration: Real = number(60.0, "Simulated time of a trial", "s", gt=0, le=86_400)
    period: Real = number(1.0, "Period of the motor signals", "s", gt=0, le=86_400)
    max_amplitude: Real = number(
        0.1, "Change of a muscle's rest length at full amplitude, relative to its length", gt=0, lt=1
    )


# --- learning ------------------------------------------------------------------------------------------------------


class LearningSettings(Section, frozen=True):
    """Trial and error: keep the best behaviours, perturb them, try again."""

    epochs: Whole = number(4000, "Epochs of a run", ge=1, le=MAX_EPOCHS)
    population: Whole = number(20, "Behaviours tried in an epoch", ge=2, le=10_000)
    parents: Whole = number(5, "Best behaviours kept; fewer than the population", ge=1, le=9_999)
    rate: Real = number(0.1, "Probability that a number of a behaviour is perturbed (one at least is)", gt=0, le=1)
    scale: Real = number(0.025, "Standard deviation of a perturbation", ge=1e-9, le=10)
    direction: Literal["forward", "either"] = Field(
        default="forward", description="Performance: displacement along +x (forward) or its size (either)."
    )

    @model_validator(mode="after")
    def _has_children(self) -> LearningSettings:
        if self.parents >= self.population:
            raise refusal(
                f"keeping {self.parents} of {self.population} behaviours leaves nothing new to try; "
                f"use at most {self.population - 1} parents or a larger population",
                ("parents",),
                ("population",),
            )
        return self


def _dimensions(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


def _distinct(value: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(value)) < len(value):
        raise refusal("a dimension is listed twice; list each once")
    return value


DimensionList = Annotated[list[Dimension], Field(min_length=1, max_length=4, json_schema_extra={"uniqueItems": True})]
Dimensions = Annotated[
    tuple[Dimension, ...],
    AfterValidator(_distinct),
    BeforeValidator(_dimensions, json_schema_input_type=Dimension | DimensionList),
    PlainSerializer(lambda value: value[0] if len(value) == 1 else list(value), return_type=str | list[str]),
]


class WobbleSettings(Section, frozen=True):
    """How the morphology oscillates: factor(epoch) = mean + amplitude sin(2 pi epoch / period)."""

    dimension: Dimensions = text(
        ...,
        "What wobbles",
        "mass, stiffness, size or gravity, or a list of them",
        min_length=1,
        max_length=4,
    )
    amplitude: Real = number(..., "Amplitude of the factor", ge=0, le=1000)
    period: Real = number(..., "Period; the sine is sampled once an epoch", "epochs", gt=2, le=1e6)
    end: Whole = number(
        2000, "First epoch of the adult; beyond learning.epochs the run ends wobbling", "epochs", ge=1, le=MAX_EPOCHS
    )
    decay_start: Whole | None = number(
        None, "Epoch from which the amplitude shrinks, null: the last 5 % before end", "epochs", ge=0, le=MAX_EPOCHS
    )
    mean: Real = number(1.0, "Mean of the factor while wobbling", gt=0, le=1000)
    upper_bound: Real | None = number(None, "Largest factor, null: no bound", gt=0, le=1000)

    @property
    def least_factor(self) -> float:
        """The least value of the sine's range, whichever epochs sample it (no unit)."""
        return round(self.mean - self.amplitude, 12)

    @model_validator(mode="after")
    def _possible(self) -> WobbleSettings:
        if self.least_factor <= 0:
            raise refusal(
                f"the least {' and '.join(self.dimension)} factor is {self.least_factor:g} (mean {self.mean:g} minus "
                f"amplitude {self.amplitude:g}), and a factor must be above 0; "
                f"use an amplitude below {self.mean:g} or a larger mean",
                ("amplitude",),
                ("mean",),
            )
        if self.decay_start is not None and self.decay_start > self.end:
            raise refusal(
                f"the decay starts at epoch {self.decay_start}, after the end {self.end}; "
                f"use at most {self.end} or a later end",
                ("decay_start",),
                ("end",),
            )
        return self


# --- a condition and a sweep ---------------------------------------------------------------------------------------


class Parameters(Section, frozen=True):
    """Everything that defines one condition: a sweep without its name, seeds and grid."""

    robot: Robot = Field(default=StarfishRobot(kind="starfish"), description="The robot.")
    scene: SceneSettings = Field(default=SceneSettings(), description="The world around the robot.")
    physics: PhysicsSettings = Field(default=PhysicsSettings(), description="How the motion is computed.")
    trial: TrialSettings = Field(default=TrialSettings(), description="One trial of one behaviour.")
    learning: LearningSettings = Field(default=LearningSettings(), description="How behaviours are learned.")
    wobble: WobbleSettings | None = Field(default=None, description="How the morphology oscillates; null: fixed.")
    log: Literal["epochs", "trials", "behaviours"] = Field(
        default="epochs", description="What is stored besides the runs: epochs, also trials, also behaviours."
    )

    def changed(self, sections: dict[str, Any]) -> Parameters:
        """Return a copy with other sections, which are taken to be valid; only what concerns several is checked.

        Validation would check every robot and wobble of thousands of conditions once more.

        Raises
        ------
        PydanticCustomError
            If the sections do not go together.
        """
        changed = self.model_copy(update=sections)
        changed._check()
        return changed

    @model_validator(mode="after")
    def _consistent(self) -> Parameters:
        self._check()
        return self

    def _check(self) -> None:
        self._check_steps()
        self._check_size()
        if isinstance(self.robot, CustomRobot):
            self._check_custom(self.robot)

    def _check_steps(self) -> None:
        dt, duration = self.physics.dt, self.trial.duration
        at: tuple[Path, Path] = ("trial", "duration"), ("physics", "dt")
        if duration < dt:
            raise refusal(f"a trial of {duration:g} s is shorter than one step of {dt:g} s; use at least {dt:g} s", *at)
        if duration / dt > MAX_STEPS:
            raise refusal(
                f"a trial of {duration:g} s at a step of {dt:g} s takes {duration / dt:.3g} steps; "
                f"at most {MAX_STEPS:,} are allowed",
                *at,
            )

    def _check_size(self) -> None:
        if self.wobble is None or "size" not in self.wobble.dimension or not isinstance(self.robot, StarfishRobot):
            return
        least = self.wobble.least_factor * self.robot.height
        if least <= self.robot.least_height:
            raise refusal(
                f"the least size factor {self.wobble.least_factor:g} makes sections {least:g} u high, and this robot "
                f"can only be built above {self.robot.least_height:g} u; use a smaller amplitude",
                ("wobble", "amplitude"),
                ("wobble", "mean"),
                ("robot", "height"),
            )

    def _check_custom(self, robot: CustomRobot) -> None:
        floor = self.scene.floor is not None
        largest_sign, lowest = robot.bounds
        if largest_sign * self.trial.max_amplitude < 1 and not (floor and lowest < 0):
            return
        for i, muscle in enumerate(robot.muscles):
            if abs(muscle.sign) * self.trial.max_amplitude >= 1:
                raise refusal(
                    f"sign {muscle.sign:g} times trial.max_amplitude {self.trial.max_amplitude:g} lets the muscle "
                    "shrink to nothing; keep the product below 1",
                    ("robot", "muscles", i, "sign"),
                    ("trial", "max_amplitude"),
                )
        for i, node in enumerate(robot.nodes):
            if floor and node.position[1] < 0 and not node.fixed:
                raise refusal(
                    f"node {i} starts below the floor (y = {node.position[1]:g}); raise it to 0 or more, "
                    "or set scene.floor to null",
                    ("robot", "nodes", i, "position"),
                )


def stored_bytes(epochs: int, population: int, log: str) -> int:
    """About how many bytes a run's files take.

    From 4 runs of the starfish robot (24 numbers a behaviour) with 100 epochs and with 1000: the files begin with
    21.3 kB (runs), 8.9 kB (epochs), 8.0 kB (trials) and 15.0 kB (behaviours), most of it provenance; then an epoch
    takes 14 to 24 bytes, a trial 5.8 to 6.8, and its behaviour 36 to 38.
    """
    size = 30_000 + 20 * epochs
    if log != "epochs":
        size += 8_000 + 7 * epochs * population
    if log == "behaviours":
        size += 15_000 + 37 * epochs * population
    return size


def _rounded(amount: float) -> str:
    return f"{amount:,.0f}" if 10 <= amount < 1e15 else f"{amount:.2g}"


class SweepConfig(Parameters, frozen=True):
    """A whole study: the base parameters, the seeds, and the conditions to compare."""

    name: Name = text(..., "Name of the study; its results may lie in a folder of this name", NAME_RULE)
    seeds: Seeds = text((0,), "Seeds of the runs, the same in every condition", SEED_RULE)
    sweep: dict[str, Values] = text(
        {}, "Values by dotted key; their product gives the conditions", "a mapping such as wobble.period: [25, 50]"
    )
    conditions: dict[Name, Override] = text(
        {},
        "Named conditions, each with its changes to the base; added to those of sweep",
        "a mapping such as fixed: {wobble: null}",
    )

    @field_validator("sweep")
    @classmethod
    def _sweepable(cls, sweep: dict[str, tuple[Any, ...]]) -> dict[str, tuple[Any, ...]]:
        if len(sweep) > MAX_SWEPT_KEYS:
            raise refusal(f"sweeps {len(sweep):,} keys; at most {MAX_SWEPT_KEYS} are allowed")
        for key, values in sweep.items():
            if not values:
                raise refusal("has no values; give at least one, or remove the key", (key,))
            for i, value in enumerate(values):
                if isinstance(value, dict):
                    raise refusal("a mapping cannot be swept; give it a name under conditions", (key, i))
            double = first_double(values)
            if double is not None:
                raise refusal(f"{shown(values[double])} is listed twice; list each value once", (key, double))
            outer = next((other for other in sweep if key.startswith(other + ".")), None)
            if outer:
                raise refusal(f"lies inside {outer}, which is swept too; sweep one of them", (key,))
        return sweep

    @field_validator("conditions")
    @classmethod
    def _told_apart(cls, conditions: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        seen: dict[str, str] = {}
        for name in conditions:
            twin = seen.setdefault(name.lower(), name)
            if twin != name:
                raise refusal(f"differs from {twin} only in case, which some file systems ignore; rename it", (name,))
            check_id(name, (name,))
        return conditions

    @model_validator(mode="after")
    def _named(self) -> SweepConfig:
        """The name of a study with one condition is the id of that condition."""
        if not self.sweep and not self.conditions:
            check_id(self.name, ("name",))
        return self

    @model_validator(mode="after")
    def _affordable(self) -> SweepConfig:
        conditions = self.count_conditions()
        runs = conditions * len(self.seeds)
        at = ("sweep",) if self.sweep else ("conditions",) if self.conditions else ("seeds",)
        if conditions > MAX_CONDITIONS:
            raise refusal(
                f"the grid has {conditions:,} conditions ({self.cost()}); at most {MAX_CONDITIONS:,} are allowed, so "
                "leave some out",
                at,
            )
        if runs > MAX_RUNS:
            raise refusal(
                f"{conditions:,} conditions with {len(self.seeds):,} seeds are {self.cost()}; at most {MAX_RUNS:,} "
                "runs are allowed, so use fewer conditions or seeds",
                at,
            )
        return self

    def cost(self, epochs: int | None = None) -> str:
        """Say how many runs, simulated hours and bytes of results the study is, or would be with so many epochs.

        Every condition counts as the base does, so that it costs nothing to say of a grid too large to lay out.
        """
        runs = self.count_conditions() * len(self.seeds)
        trials = (epochs or self.learning.epochs) * self.learning.population
        hours = runs * trials * self.trial.duration / 3600
        size = runs * stored_bytes(epochs or self.learning.epochs, self.learning.population, self.log)
        what = f"{runs:,} run{'s' * (runs != 1)}, {_rounded(hours)} simulated hours"
        return f"{what} and about {_rounded(size / 1e9)} GB of results"

    def count_conditions(self) -> int:
        """How many conditions the grid has, without building them."""
        product = math.prod(len(values) for values in self.sweep.values()) if self.sweep else 0
        return product + len(self.conditions) or 1

    @property
    def parameters(self) -> Parameters:
        """The base parameters, before any condition changes them."""
        return Parameters(**{name: value for name, value in self if name in Parameters.model_fields})
