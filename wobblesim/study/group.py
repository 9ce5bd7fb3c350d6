"""Groups of runs: what is computed together, has a checkpoint, and is told of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from wobblesim.study.manifest import RunKey


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
