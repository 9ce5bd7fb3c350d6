"""The search: rank the behaviours, keep the best, perturb them into the others.

This is "Trial & Error Learning" of Benureau & Tani (2022), section II-B, and knows nothing of robots or epochs: a
population is an array of behaviours, a performance is one number per behaviour.

A behaviour is `2 * n_groups` numbers: the amplitudes of all motor groups in [0, 1], then their offsets in turns.

Every random number comes from `Generator.random` and operations that IEEE 754 defines exactly, so that a search has
the same bits on every CPU: NumPy's own normal numbers call `log1p` and `exp` of the C library, which promises no bits.
"""

from dataclasses import dataclass

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence

from wobblesim.robot.gait import sin_turns

DIRECTIONS = ("forward", "either")
LEAST_SCALE = 1e-9
"""Smallest perturbation scale: far above the last bit of an offset, so that a perturbation always changes something."""


@dataclass(frozen=True)
class Search:
    """How new behaviours are made from tried ones.

    Parameters
    ----------
    population : int
        Behaviours tried in an epoch.
    parents : int
        The best of them that are kept, unchanged, for the next epoch; at least 1 and fewer than `population`.
    rate : float
        Probability that a perturbation touches a coordinate, in (0, 1]; it always touches at least one.
    scale : float
        Standard deviation of a perturbed coordinate: of an amplitude (fraction of the largest) or an offset (turns).
    direction : {"forward", "either"}
        Whether only a displacement along +x counts, or its absolute value.

    Raises
    ------
    ValueError
        If a value is out of its range.
    """

    population: int = 20
    parents: int = 5
    rate: float = 0.1
    scale: float = 0.025
    direction: str = "forward"

    def __post_init__(self) -> None:
        if not 1 <= self.parents < self.population:
            raise ValueError(
                f"search: parents must be at least 1 and fewer than the population of {self.population}, "
                f"got {self.parents}"
            )
        if not 0.0 < self.rate <= 1.0:
            raise ValueError(f"search: rate must be above 0 and at most 1, got {self.rate}")
        if not LEAST_SCALE <= self.scale < np.inf:
            raise ValueError(f"search: scale must be finite and at least {LEAST_SCALE}, got {self.scale}")
        if self.direction not in DIRECTIONS:
            raise ValueError(f"search: direction must be one of {', '.join(DIRECTIONS)}, got {self.direction!r}")


def generator(seed: int) -> Generator:
    """The random numbers of the run with this seed: the same in every condition, so that runs are paired."""
    return Generator(PCG64(SeedSequence(seed)))


def initial_population(rng: Generator, search: Search, n_groups: int) -> np.ndarray:
    """Behaviours of epoch 0, (population, 2 * n_groups): every amplitude and offset uniform in [0, 1)."""
    return rng.random((search.population, 2 * n_groups))


def score(displacement: np.ndarray, direction: str) -> np.ndarray:
    """Performance in body lengths of `displacement` along +x; NaN stays NaN."""
    return np.abs(displacement) if direction == "either" else displacement


def ranking(performance: np.ndarray) -> np.ndarray:
    """Slots of `performance` (n,), best first; NaN last; ties, also among NaNs, by slot."""
    return np.argsort(-performance, kind="stable")


def offspring(
    rng: Generator, population: np.ndarray, performance: np.ndarray, search: Search
) -> tuple[np.ndarray, np.ndarray]:
    """The next population: the best behaviours as they are, then their perturbations in turn.

    Parameters
    ----------
    rng : Generator
        Advanced in place.
    population : (P, 2G) array
        Behaviours just tried.
    performance : (P,) array
        Their scores in body lengths. A NaN is kept only if fewer than `search.parents` are numbers.

    Returns
    -------
    behaviours : (P, 2G) array
        Slots `0 .. parents - 1` hold the kept ones, best first, bit for bit; slot `parents + i` a perturbation of kept
        one `i mod parents`.
    parent : (P,) int array
        The slot in `population` that each of them was, or was made from.
    """
    kept = ranking(performance)[: search.parents]
    parent = kept[np.arange(search.population) % search.parents]
    behaviours = population[parent]
    behaviours[search.parents :] = perturbed(rng, behaviours[search.parents :], search)
    return behaviours, parent


def perturbed(rng: Generator, behaviours: np.ndarray, search: Search) -> np.ndarray:
    """A changed copy of each row of `behaviours` (n, 2G); none is equal to its original."""
    changed = _attempt(rng, behaviours, search)
    # An amplitude at 0 or 1 that is pushed outward is clipped back to where it was. Where nothing else was touched
    # the copy would be a trial wasted on a behaviour already known: draw again.
    while (same := (changed == behaviours).all(axis=1)).any():
        changed[same] = _attempt(rng, behaviours[same], search)
    return changed


def _attempt(rng: Generator, behaviours: np.ndarray, search: Search) -> np.ndarray:
    """`behaviours` (n, 2G) with normal noise on the touched coordinates; offsets are periodic and need no clipping."""
    n, width = behaviours.shape
    touched = _touched(rng, n, width, search.rate)
    uniform, changed = rng.random((2, n, width)), behaviours.copy()
    changed[touched] += search.scale * _normal(*uniform[:, touched])  # one in ten: the others are not worked out
    changed[:, : width // 2] = np.clip(changed[:, : width // 2], 0.0, 1.0)
    return changed


def _touched(rng: Generator, n: int, width: int, rate: float) -> np.ndarray:
    """Mask (n, width), each element True with probability `rate`; a row left empty gets one element, at random."""
    touched = rng.random((n, width)) < rate
    fallback = (rng.random(n) * width).astype(np.intp)
    empty = np.flatnonzero(~touched.any(axis=1))
    touched[empty, fallback[empty]] = True
    return touched


def standard_normal(rng: Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Normal numbers by the transform of Box & Muller (1958), of the same bits on every CPU."""
    return _normal(*rng.random((2, *shape)))


def _normal(radius: np.ndarray, turns: np.ndarray) -> np.ndarray:
    return np.sqrt(-2.0 * _log(1.0 - radius)) * sin_turns(turns)


LOG_2 = 0.6931471805599453


def _log(x: np.ndarray) -> np.ndarray:
    """Natural logarithm of x > 0 within 2 units in the last place, from operations that IEEE 754 defines exactly.

    With x = m 2^e, m in [sqrt(1/2), sqrt(2)), log x = e log 2 + 2 atanh t at t = (m - 1)/(m + 1). As |t| <= 0.172,
    the series t + t^3/3 + ... cut behind t^21 is off by less than 1e-18.
    """
    m, e = np.frexp(x)
    low = m < np.sqrt(0.5)
    m, e = np.where(low, 2.0 * m, m), e - low
    t = (m - 1.0) / (m + 1.0)
    series = np.zeros_like(t)
    for k in range(21, 0, -2):
        series = series * (t * t) + 1.0 / k
    return e * LOG_2 + 2.0 * t * series
