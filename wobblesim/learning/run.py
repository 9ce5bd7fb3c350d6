"""Learning runs: epochs of trials, ranking and perturbation while the morphology wobbles.

`Learner` advances the runs of one condition in lockstep, one run per seed. They share nothing but the call of
`simulate`, which is cheaper for many robots at once; each has its own random numbers, so its bits do not depend on
which other seeds, or how many, run beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator

from wobblesim.learning.search import Search, generator, initial_population, offspring, ranking, score
from wobblesim.learning.wobble import Wobble
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology

OUTCOME = {
    "performance": np.float64,
    "status": "U8",
    "dt": np.float64,
    "bound": "U6",
    "limited": np.int64,
    "diverged_at": np.float64,
}
"""What is known of a tried behaviour, and goes with it while it is kept: an array (seeds, population) each."""


@dataclass(frozen=True)
class Setup:
    """One condition: all that its runs share. A run is a setup and a seed.

    Parameters
    ----------
    body : Body
        The adult robot.
    scene, physics, gait
        As for `simulate`.
    duration : float
        Of a trial, s.
    search : Search
    wobble : Wobble or None
        None for a fixed morphology, the adult's.
    epochs : int
        At least 1.
    half : int, optional
        Where the search distance is split, see `Setup.split`.
    """

    body: Body
    scene: Scene
    physics: Physics
    gait: Gait
    duration: float
    search: Search
    wobble: Wobble | None
    epochs: int
    half: int | None = None

    def __post_init__(self) -> None:
        if self.epochs < 1:
            raise ValueError(f"learning: epochs must be at least 1, got {self.epochs}")

    def morphology(self, epoch: int) -> Morphology:
        """The robot of an epoch."""
        if self.wobble is None:
            return Morphology()
        if epoch >= self.epochs:
            return self.wobble.morphology(epoch)
        return Morphology(**dict.fromkeys(self.wobble.dimensions, float(self._factors[epoch])))

    @cached_property
    def _factors(self) -> np.ndarray:
        """The factor of each epoch, computed together: one by one they take a third of the learner's time."""
        assert self.wobble is not None
        return self.wobble.factor(np.arange(self.epochs))

    @property
    def split(self) -> int:
        """Last epoch of `path_before`: `half`, else where the wobble ends, else half the epochs."""
        if self.half is not None:
            return self.half
        return self.wobble.end if self.wobble else self.epochs // 2


@dataclass(frozen=True, eq=False)
class Epoch:
    """What one epoch tried and found; S seeds, P behaviours (slots) each, G motor groups.

    Attributes
    ----------
    epoch : int
    morphology : Morphology
        Of all trials of this epoch.
    behaviours : (S, P, 2G)
        Amplitudes, then offsets in turns. From epoch 1 on the kept ones come first, best first.
    performance : (S, P)
        Body lengths of the adult; NaN where the trial diverged.
    status : (S, P) str
        "ok", "limited", "refined" or "diverged", see `Trials`.
    dt : (S, P)
        Step of the run that this is the outcome of, s.
    bound : (S, P) str
        Which trusted bound the trial left at first; empty if none.
    limited : (S, P) int
        Times a limiter acted in the trial.
    diverged_at : (S, P)
        s; NaN where the trial did not diverge.
    reused : (S, P) bool
        Not simulated: kept, and the morphology is that of its last trial, so the outcome is the same bits.
    parent : (S, P) int
        Slot of the previous epoch that a behaviour was, or was made from; -1 in epoch 0.
    best : (S,) int
        Slot of the best. Its performance is NaN if, and only if, every trial of the seed diverged.
    path : (S,)
        Search distance: sum of the Euclidean norms of all modifications from the best behaviour's ancestor in epoch 0
        to the best behaviour. Offsets count as the numbers they are, not modulo 1.
    path_before : (S,)
        The part of it from modifications that were first tried in epochs <= `Setup.split`.
    step_distance : (S,)
        Euclidean distance from the best behaviour of the previous epoch to this one's; NaN in epoch 0.
    """

    epoch: int
    morphology: Morphology
    behaviours: np.ndarray
    performance: np.ndarray
    status: np.ndarray
    dt: np.ndarray
    bound: np.ndarray
    limited: np.ndarray
    diverged_at: np.ndarray
    reused: np.ndarray
    parent: np.ndarray
    best: np.ndarray
    path: np.ndarray
    path_before: np.ndarray
    step_distance: np.ndarray


class Learner:
    """Runs of one setup, one per seed, in lockstep.

    Parameters
    ----------
    setup : Setup
    seeds : sequence of int
    threads : int, optional
        As for `simulate`.
    reuse : bool
        False tries kept behaviours again also where the outcome is known: the same bits, more slowly.
    simulate : callable
        Called as `wobblesim.simulate` is; another one makes another task of it.

    Attributes
    ----------
    epoch : int
        The epoch that `advance` runs next.

    Raises
    ------
    ValueError
        If there is no seed.
    """

    def __init__(
        self,
        setup: Setup,
        seeds: Sequence[int],
        threads: int | None = None,
        *,
        reuse: bool = True,
        simulate: Callable[..., Trials] = simulate,
    ) -> None:
        if len(seeds) == 0:
            raise ValueError("learning: there is no seed to run; give at least one")
        self.setup, self.seeds, self.threads, self.reuse, self._simulate = setup, tuple(seeds), threads, reuse, simulate
        self.epoch = 0
        self._generators = [generator(seed) for seed in seeds]
        # The population that the next epoch tries, and what is known of each behaviour, or of what it was made from.
        n_groups = setup.body.n_groups
        self._behaviours = np.stack([initial_population(rng, setup.search, n_groups) for rng in self._generators])
        shape = self._behaviours.shape[:2]
        self._parent = np.full(shape, -1)
        self._outcome = {name: np.zeros(shape, dtype) for name, dtype in OUTCOME.items()}
        self._path, self._path_before = np.zeros(shape), np.zeros(shape)
        self._last_best = np.full((len(seeds), 2 * n_groups), np.nan)

    @property
    def done(self) -> bool:
        """Whether all epochs of the setup have run."""
        return self.epoch >= self.setup.epochs

    def advance(self) -> Epoch:
        """Run the next epoch: wobble, try every behaviour, keep the best and perturb them for the epoch after.

        If `simulate` raises (or is interrupted), the learner stays as it was.

        Raises
        ------
        ValueError
            If the learner is done.
        """
        if self.done:
            raise ValueError(f"learning: all {self.setup.epochs} epochs have run; give the setup more to go on")
        morphology = self.setup.morphology(self.epoch)
        reused = self._reusable(morphology)
        outcome = self._try(morphology, ~reused)
        best = np.array([ranking(performance)[0] for performance in outcome["performance"]])
        of_best = np.arange(len(self.seeds)), best
        epoch = Epoch(
            epoch=self.epoch,
            morphology=morphology,
            behaviours=self._behaviours,
            **outcome,
            reused=reused,
            parent=self._parent,
            best=best,
            path=self._path[of_best],
            path_before=self._path_before[of_best],
            step_distance=_distance(self._last_best, self._behaviours[of_best]),
        )
        self._last_best = self._behaviours[of_best]
        self._breed(outcome)
        return epoch

    def _reusable(self, morphology: Morphology) -> np.ndarray:
        """Mask (S, P) of behaviours whose outcome is known: kept, the morphology that of the last epoch."""
        reusable = np.zeros(self._parent.shape, dtype=bool)
        if self.reuse and self.epoch > 0 and morphology == self.setup.morphology(self.epoch - 1):
            reusable[:, : self.setup.search.parents] = True
        return reusable

    def _try(self, morphology: Morphology, lanes: np.ndarray) -> dict[str, np.ndarray]:
        """Outcomes (S, P) of all behaviours, those of `lanes` (S, P) simulated, of all seeds in one call."""
        setup = self.setup
        trials = self._simulate(
            setup.body,
            self._behaviours[lanes],
            morphology=morphology,
            scene=setup.scene,
            physics=setup.physics,
            gait=setup.gait,
            duration=setup.duration,
            threads=self.threads,
        )
        outcome = {name: known.copy() for name, known in self._outcome.items()}
        outcome["performance"][lanes] = score(trials.displacement, setup.search.direction)
        for name in OUTCOME.keys() - {"performance"}:
            outcome[name][lanes] = getattr(trials, name)
        return outcome

    def _breed(self, outcome: dict[str, np.ndarray]) -> None:
        """Make the next epoch's population, and hand down to it what is known of its parents."""
        tried, performance = self._behaviours, outcome["performance"]
        bred = [
            offspring(rng, tried[seed], performance[seed], self.setup.search)
            for seed, rng in enumerate(self._generators)
        ]
        self._behaviours = np.stack([behaviours for behaviours, _ in bred])
        self._parent = parent = np.stack([parent for _, parent in bred])
        self._outcome = {name: _take(known, parent) for name, known in outcome.items()}
        self.epoch += 1

        modification = _distance(_take(tried, parent), self._behaviours)
        self._path = _take(self._path, parent) + modification
        counted = modification if self.epoch <= self.setup.split else 0.0
        self._path_before = _take(self._path_before, parent) + counted

    def snapshot(self) -> dict[str, np.ndarray]:
        """All that `restored` needs to go on with the same bits, between two epochs, as plain arrays (no pickle)."""
        state = {name: getattr(self, f"_{name}").copy() for name in STATE}
        outcome = {name: known.copy() for name, known in self._outcome.items()}
        words = np.stack([_words(rng) for rng in self._generators])
        return {"epoch": np.array(self.epoch), "generator": words, **state, **outcome}

    @classmethod
    def restored(
        cls,
        setup: Setup,
        seeds: Sequence[int],
        snapshot: Mapping[str, np.ndarray],
        threads: int | None = None,
        *,
        reuse: bool = True,
        simulate: Callable[..., Trials] = simulate,
    ) -> Learner:
        """The learner that a snapshot was taken of, with the setup and the seeds it had then.

        Raises
        ------
        ValueError
            If the snapshot lacks an array, or has one of another shape than the setup and the seeds need.
        """
        learner = cls(setup, seeds, threads, reuse=reuse, simulate=simulate)
        _check_snapshot(snapshot, learner.snapshot())
        learner.epoch = int(snapshot["epoch"])
        learner._generators = [_generator_of(words) for words in snapshot["generator"]]
        for name in STATE:
            setattr(learner, f"_{name}", snapshot[name].copy())
        learner._outcome = {name: snapshot[name].copy() for name in OUTCOME}
        return learner


STATE = ("behaviours", "parent", "path", "path_before", "last_best")
"""Arrays of a learner, besides outcomes and random numbers, that last from epoch to epoch."""


def _distance(origin: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Euclidean distance along the last axis, without BLAS, whose sums have other bits on other CPUs."""
    return np.sqrt(np.square(target - origin).sum(axis=-1))


def _take(known: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """Of each behaviour what is known (S, P, ...) of its parent (S, P)."""
    return known[np.arange(len(parent))[:, None], parent]  # a fifth of the time of np.take_along_axis


def _check_snapshot(snapshot: Mapping[str, np.ndarray], fresh: Mapping[str, np.ndarray]) -> None:
    """Refuse a snapshot that is not one of these seeds and this setup."""
    for name, array in fresh.items():
        if name not in snapshot:
            raise ValueError(f"learning: the snapshot has no {name!r}; start the runs anew")
        if np.shape(snapshot[name]) != array.shape:
            raise ValueError(
                f"learning: the snapshot's {name!r} has shape {np.shape(snapshot[name])}, this setup and these seeds "
                f"need {array.shape}; restore it with those it was taken with"
            )


def _words(rng: Generator) -> np.ndarray:
    """State of a PCG64 generator as 6 words of 64 bits."""
    state = rng.bit_generator.state
    numbers = (state["state"]["state"], state["state"]["inc"])
    halves = [half for number in numbers for half in (number >> 64, number & (2**64 - 1))]
    return np.array([*halves, state["has_uint32"], state["uinteger"]], dtype=np.uint64)


def _generator_of(words: np.ndarray) -> Generator:
    """The generator whose state `_words` wrote."""
    state_high, state_low, inc_high, inc_low, has_uint32, uinteger = (int(word) for word in words)
    rng = generator(0)
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state_high << 64 | state_low, "inc": inc_high << 64 | inc_low},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return rng
