"""The motors: one sinusoid per group, given by an amplitude and an offset in turns.

NumPy and the C library choose their sine by CPU, and the choices differ in the last bit. The sine here uses
only additions, multiplications and rounding, which IEEE 754 defines exactly, so a gait has the same bits on
every machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Taylor coefficients of sin and cos; on |x| <= pi/4 the first term left out is below 2e-19 of the result.
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(9))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(10))


@dataclass(frozen=True)
class Gait:
    """What all motor groups share.

    Parameters
    ----------
    period : float
        Period of every motor, s.
    max_amplitude : float
        Relative change of a muscle's rest length at amplitude 1 (0.1: from 0.9 to 1.1 of it).

    Raises
    ------
    ValueError
        If the period is not above 0, or the amplitude not in [0, 1).
    """

    period: float = 1.0
    max_amplitude: float = 0.1

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and self.period > 0):
            raise ValueError(f"the gait's period is {self.period} s: it must be a finite time above 0")
        if not 0 <= self.max_amplitude < 1:
            raise ValueError(f"the gait's max_amplitude is {self.max_amplitude}: it must lie in [0, 1)")


def _horner(coefficients: tuple[float, ...], z: NDArray[np.float64]) -> NDArray[np.float64]:
    result = np.full_like(z, coefficients[-1])  # highest power first
    for coefficient in coefficients[-2::-1]:
        result = result * z + coefficient
    return result


def sin_turns(turns: ArrayLike) -> NDArray[np.float64]:
    """Sine of an angle given in turns, sin(2 pi turns), within 2 units in the last place of 1.

    The angle is reduced exactly: whole turns and quarter turns are taken off before anything is rounded.
    """
    turns = np.asarray(turns, dtype=np.float64)
    part = turns - np.rint(turns)
    quarter = np.rint(4.0 * part)
    x = (part - 0.25 * quarter) * (2.0 * math.pi)
    z = x * x
    sine, cosine = x * _horner(_SINE, z), _horner(_COSINE, z)
    return np.asarray(np.choose(quarter.astype(np.int64) & 3, [sine, cosine, -sine, -cosine]))


def cos_turns(turns: ArrayLike) -> NDArray[np.float64]:
    """Cosine of an angle given in turns, cos(2 pi turns): see `sin_turns`."""
    turns = np.asarray(turns, dtype=np.float64)
    # A quarter turn is added after the whole turns are gone, so that large angles lose nothing.
    return sin_turns(turns - np.rint(turns) + 0.25)


def split_behaviours(behaviours: NDArray[np.float64], gait: Gait) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Write each group's signal as a sum of the clock's sine and cosine.

    ``A sin(2 pi (t/period + offset)) = S sin(2 pi t/period) + C cos(2 pi t/period)``, so that a step needs
    one sine and one cosine for all robots and groups.

    Parameters
    ----------
    behaviours : (n_trials, 2 n_groups)
        Amplitudes in units of `Gait.max_amplitude`, then offsets in turns.

    Returns
    -------
    S, C : (n_groups, n_trials)
    """
    amplitudes, offsets = np.split(np.asarray(behaviours, dtype=np.float64).T, 2)
    amplitudes = gait.max_amplitude * amplitudes
    # The cosine as in `cos_turns`, both in one call: for a few behaviours it is the calls that take the time.
    cosine, sine = sin_turns(np.stack([offsets - np.rint(offsets) + 0.25, offsets]))
    return amplitudes * cosine, amplitudes * sine


def clock(gait: Gait, dt: float, n_half_steps: int) -> NDArray[np.float64]:
    """Sine and cosine of the gait's phase at every half step.

    Returns
    -------
    (n_half_steps, 2)
        Row j holds sin and cos of 2 pi t/period at t = j dt/2.
    """
    turns = np.arange(n_half_steps) * (0.5 * dt) / gait.period
    return np.stack([sin_turns(turns), cos_turns(turns)], axis=1)
