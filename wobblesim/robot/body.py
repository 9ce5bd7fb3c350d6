"""A body: point masses, springs between them, and the springs that are muscles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wobblesim.robot.morphology import Morphology

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Body:
    """An adult robot as plain arrays; nothing in the physics knows more of it than this.

    Attributes
    ----------
    position : (n_nodes, 2)
        u. The floor, where there is one, is y = 0.
    velocity : (n_nodes, 2)
        u/s.
    mass, friction : (n_nodes,)
        Mass unit; Coulomb coefficient of the node on the floor.
    fixed : (n_nodes,) bool
        A fixed node never moves and weighs on nothing.
    springs : (n_springs, 2) int
        The nodes (a, b) of each spring. Their order is the order in which `impulse` visits them.
    stiffness, damping_ratio, rest_length : (n_springs,)
        Mass unit/s², 1, u.
    muscle_spring, muscle_group, muscle_sign : (n_muscles,)
        A muscle's spring, its motor group, and its sign: it rests at ``rest_length (1 + sign alpha)``.
    n_groups : int
        Motor groups; a behaviour has 2 n_groups numbers.
    center : (n_center,) int
        The nodes whose mean position is the place of the robot.
    body_length : float
        The adult's length, u: the unit of every displacement.
    cells : (n_cells, 4) int
        Quadrilaterals whose inversions are counted (a triangle repeats its last node).
    build : callable or None
        ``build(size) -> Body``: the body grown to a size factor; None scales all lengths about the origin.
    """

    position: Floats
    velocity: Floats
    mass: Floats
    friction: Floats
    fixed: NDArray[np.bool_]
    springs: Ints
    stiffness: Floats
    damping_ratio: Floats
    rest_length: Floats
    muscle_spring: Ints
    muscle_group: Ints
    muscle_sign: Floats
    n_groups: int
    center: Ints
    body_length: float
    cells: Ints
    build: Callable[[float], Body] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        _check(self)
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.setflags(write=False)

    @property
    def n_nodes(self) -> int:
        """Number of point masses."""
        return len(self.position)

    @property
    def n_springs(self) -> int:
        """Number of springs, muscles included."""
        return len(self.springs)

    @classmethod
    def from_arrays(
        cls,
        position: ArrayLike,
        springs: ArrayLike = (),
        *,
        stiffness: ArrayLike = 1000.0,
        damping_ratio: ArrayLike = 1.0,
        rest_length: ArrayLike | None = None,
        mass: ArrayLike = 1.0,
        friction: ArrayLike = 0.5,
        fixed: ArrayLike = False,
        velocity: ArrayLike = 0.0,
        muscles: Sequence[tuple[int, int, float]] = (),
        center: ArrayLike | None = None,
        body_length: float | None = None,
        cells: ArrayLike = (),
        build: Callable[[float], Body] | None = None,
    ) -> Body:
        """Make a body from plain arrays; a scalar stands for all nodes or all springs.

        Parameters
        ----------
        position : (n_nodes, 2)
            u.
        springs : (n_springs, 2)
            Node indices (a, b).
        rest_length : (n_springs,), optional
            u; the lengths as built if not given.
        muscles : sequence of (spring, group, sign)
            Groups are numbered from 0; sign +1 lengthens while the signal is positive, -1 shortens.
        center : (n_center,), optional
            All nodes if not given.
        body_length : float, optional
            The extent along x if not given, or 1 u if that is 0.

        Raises
        ------
        ValueError
            If sizes disagree, an index names nothing, or a mass, stiffness or length is not positive.
        """
        position = np.array(position, dtype=np.float64).reshape(-1, 2)
        springs = np.array(springs, dtype=np.int64).reshape(-1, 2)
        _check_indices("spring", springs, len(position), "node")
        n, m = len(position), len(springs)
        as_built = np.hypot(*(position[springs[:, 1]] - position[springs[:, 0]]).T)
        spring, group, sign = np.array(muscles, dtype=np.float64).reshape(-1, 3).T
        extent = float(np.ptp(position[:, 0])) if n else 0.0
        return cls(
            position=position,
            velocity=_spread(velocity, (n, 2), "velocity"),
            mass=_spread(mass, (n,), "mass"),
            friction=_spread(friction, (n,), "friction"),
            fixed=_spread(fixed, (n,), "fixed", np.bool_),
            springs=springs,
            stiffness=_spread(stiffness, (m,), "stiffness"),
            damping_ratio=_spread(damping_ratio, (m,), "damping_ratio"),
            rest_length=_spread(as_built if rest_length is None else rest_length, (m,), "rest_length"),
            muscle_spring=spring.astype(np.int64),
            muscle_group=group.astype(np.int64),
            muscle_sign=sign,
            n_groups=int(group.max()) + 1 if len(group) else 0,
            center=np.arange(n) if center is None else np.array(center, dtype=np.int64),
            body_length=body_length if body_length is not None else extent or 1.0,
            cells=np.array(cells, dtype=np.int64).reshape(-1, 4),
            build=build,
        )

    def adapted(self, morphology: Morphology) -> Body:
        """Return the body with a morphology's factors on masses, muscle stiffness and size.

        The body length stays the adult's: it is the unit of performance and never wobbles.
        """
        body = self if morphology.size == 1.0 else self._grown(morphology.size)
        stiffness = body.stiffness.copy()
        stiffness[body.muscle_spring] *= morphology.stiffness
        return replace(body, mass=body.mass * morphology.mass, stiffness=stiffness, body_length=self.body_length)

    def _grown(self, size: float) -> Body:
        if self.build is not None:
            return self.build(size)
        return replace(self, position=self.position * size, rest_length=self.rest_length * size)

    def inversions(self, position: Floats) -> Ints:
        """Count the cells turned inside out.

        Parameters
        ----------
        position : (n_nodes, 2, n_trials)
            u.

        Returns
        -------
        (n_trials,) int
            Cells whose signed area has not the sign it had as built; a cell built flat is not counted.
        """
        built = _signed_area(self.position[:, :, None], self.cells)
        return np.count_nonzero(_signed_area(position, self.cells) * built < 0, axis=0)


def _signed_area(position: Floats, cells: Ints) -> Floats:
    x, y = position[cells, 0], position[cells, 1]
    diagonal_1, diagonal_2 = (x[:, 2] - x[:, 0], y[:, 2] - y[:, 0]), (x[:, 3] - x[:, 1], y[:, 3] - y[:, 1])
    return 0.5 * (diagonal_1[0] * diagonal_2[1] - diagonal_1[1] * diagonal_2[0])


def _spread(values: ArrayLike, shape: tuple[int, ...], name: str, dtype: Any = np.float64) -> NDArray[Any]:
    try:
        return np.broadcast_to(np.asarray(values, dtype=dtype), shape).copy()
    except ValueError:
        raise ValueError(f"{name} has shape {np.shape(values)}: it must fit {shape}") from None


def _check_indices(name: str, indices: Ints, size: int, what: str) -> None:
    bad = indices[(indices < 0) | (indices >= size)]
    if bad.size:
        raise ValueError(f"a {name} names {what} {bad[0]}: there are {size}, numbered from 0")


def _check(body: Body) -> None:
    """Refuse what no simulation could mean, in one sentence each."""
    n, m = body.n_nodes, body.n_springs
    if n == 0:
        raise ValueError("a body needs at least one node")
    for name, shape in {
        "velocity": (n, 2), "mass": (n,), "friction": (n,), "fixed": (n,),
        "stiffness": (m,), "damping_ratio": (m,), "rest_length": (m,),
    }.items():  # fmt: skip
        if getattr(body, name).shape != shape:
            raise ValueError(f"{name} has shape {getattr(body, name).shape}: it must have {shape}")
    _check_indices("spring", body.springs, n, "node")
    _check_indices("muscle", body.muscle_spring, m, "spring")
    _check_indices("muscle", body.muscle_group, body.n_groups, "group")
    _check_indices("centre", body.center, n, "node")
    _check_indices("cell", body.cells, n, "node")
    if len(np.unique(body.muscle_spring)) < len(body.muscle_spring):
        raise ValueError("a spring can be a muscle of one group only")
    if np.any(body.springs[:, 0] == body.springs[:, 1]):
        raise ValueError("a spring must join two different nodes")
    for name, bound, sign in [
        ("mass", 0, ">"), ("stiffness", 0, ">"), ("damping_ratio", 0, ">="), ("rest_length", 0, ">="),
        ("friction", 0, ">="), ("position", -np.inf, ">"), ("velocity", -np.inf, ">"),
    ]:  # fmt: skip
        values = getattr(body, name)
        good = np.isfinite(values) & (values > bound if sign == ">" else values >= bound)
        if not good.all():
            allowed = "finite" if bound == -np.inf else f"finite and {sign} {bound}"
            raise ValueError(f"{name} holds {values[~good].flat[0]}: each must be {allowed}")
    if not (np.isfinite(body.body_length) and body.body_length > 0):
        raise ValueError(f"body_length is {body.body_length} u: it must be finite and > 0")
    if len(body.center) == 0:
        raise ValueError("the centre needs at least one node")
