"""Morphological wobbling: the sine that moves the morphology away from the adult's, epoch by epoch.

Benureau & Tani (2022), section II-C: a sine of constant amplitude for the first 1900 epochs, its amplitude falling
linearly to zero from epoch 1900 to 2000, the adult after that. The morphology never changes within an epoch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import overload

import numpy as np

from wobblesim.robot.gait import sin_turns
from wobblesim.robot.morphology import Morphology

DIMENSIONS = tuple(field.name for field in fields(Morphology))
DECAY_PART = 20
"""The last 1/20 (5 %) of a wobble is its decay: epochs 1900 to 2000 of the paper's 2000."""


@dataclass(frozen=True)
class Wobble:
    """Schedule of the factors on the adult's morphology.

    At epoch n the factor on every wobbling dimension is ::

        mean + amplitude * sin(2 pi n / period)                                         n < decay_start
        mean + amplitude * (end - n) / (end - decay_start) * sin(2 pi n / period)       decay_start <= n < end
        1                                                                               n >= end

    and, before `end`, never above `upper_bound`. Only the amplitude decays: with a mean other than 1 the factor jumps
    from the mean to 1 at `end`.

    Parameters
    ----------
    dimension : str or sequence of str
        Which factors wobble, together: "mass", "stiffness", "size", "gravity".
    amplitude : float
        Of the sine, as a part of the adult's value.
    period : float
        Of the sine, in epochs; above 2, for a shorter one is not seen at whole epochs (2 itself hits only zeros).
    end : int
        First epoch with the adult's morphology.
    decay_start : int, optional
        First epoch of the decay; by default the last 5 % of `end` (in whole epochs, rounded down) are the decay.
    mean : float
        Around which the sine moves; 1 except in the paper's third condition (section III-A). The "mean of 0.9,
        amplitude of 0.95" printed there would need a negative mass. The range it describes, that of its second
        condition, is mean 0.95 with amplitude 0.05.
    upper_bound : float, optional
        Cuts the factor; 1.0 gives the paper's second condition, which rests at the adult for half of each period.

    Raises
    ------
    ValueError
        If a value is out of its range, or if the sine can take a factor to 0 or below.
    """

    dimension: str | Sequence[str]
    amplitude: float
    period: float
    end: int = 2000
    decay_start: int | None = None
    mean: float = 1.0
    upper_bound: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.dimension, str):
            object.__setattr__(self, "dimension", tuple(self.dimension))
        self._check_dimensions()
        if not 0.0 <= self.amplitude < np.inf:
            raise ValueError(f"wobble: amplitude must be finite and at least 0, got {self.amplitude}")
        if not 2.0 < self.period < np.inf:
            raise ValueError(f"wobble: period must be finite and longer than 2 epochs, got {self.period}")
        if self.end < 1:
            raise ValueError(f"wobble: end must be at least 1 epoch, got {self.end}; a fixed robot has no wobble")
        if not 0 <= self.decay_from <= self.end:
            raise ValueError(f"wobble: decay_start must lie between 0 and end ({self.end}), got {self.decay_start}")
        if not np.isfinite(self.mean):
            raise ValueError(f"wobble: mean must be finite, got {self.mean}")
        if not self._bound > 0.0:
            raise ValueError(f"wobble: upper_bound must be above 0, got {self.upper_bound}")
        if (least := self.least_factor()) <= 0.0:
            raise ValueError(
                f"wobble: least {' and '.join(self.dimensions)} factor is {least:.3g}, it must be above 0; "
                f"choose an amplitude below the mean of {self.mean:g}"
            )

    def _check_dimensions(self) -> None:
        unknown = [name for name in self.dimensions if name not in DIMENSIONS]
        if unknown or not self.dimensions:
            raise ValueError(f"wobble: dimension must be among {', '.join(DIMENSIONS)}, got {self.dimension!r}")

    @property
    def dimensions(self) -> tuple[str, ...]:
        """The names of the factors that wobble."""
        return (self.dimension,) if isinstance(self.dimension, str) else tuple(self.dimension)

    @property
    def decay_from(self) -> int:
        """First epoch of the decay: `decay_start`, or what it is by default."""
        return self.end - self.end // DECAY_PART if self.decay_start is None else self.decay_start

    @overload
    def factor(self, epoch: int) -> float: ...
    @overload
    def factor(self, epoch: np.ndarray) -> np.ndarray: ...
    def factor(self, epoch: int | np.ndarray) -> float | np.ndarray:
        """Factor at an epoch, or at each of an array of them; exactly periodic, and of the same bits on every CPU."""
        n = np.asarray(epoch, dtype=np.float64)
        # fmod is exact: epochs one period apart meet the very same turn, and no rounding grows with the epoch.
        sine = sin_turns(np.fmod(n, self.period) / self.period)
        wobbling = np.minimum(self.mean + self._amplitude(n) * sine, self._bound)
        factor = np.where(n < self.end, wobbling, 1.0)
        return float(factor) if factor.ndim == 0 else factor

    def _amplitude(self, n: np.ndarray) -> np.ndarray:
        """Amplitude at epochs `n`: constant, then linear to 0 at `end`."""
        decay = max(self.end - self.decay_from, 1)
        return self.amplitude * np.clip((self.end - n) / decay, 0.0, 1.0)

    @property
    def _bound(self) -> float:
        return np.inf if self.upper_bound is None else self.upper_bound

    def morphology(self, epoch: int) -> Morphology:
        """The robot of this epoch, for all trials of all behaviours."""
        return Morphology(**dict.fromkeys(self.dimensions, self.factor(epoch)))

    def least_factor(self) -> float:
        """The least factor that the sine can reach, whether or not an epoch falls on its trough."""
        return min(self.mean - self.amplitude, self._bound, 1.0)
