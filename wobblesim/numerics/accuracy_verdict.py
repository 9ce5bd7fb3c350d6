"""What the rows of `accuracy` come to: the cheapest settings, and how far the project's goal is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from wobblesim.numerics.accuracy import POOLED, Row

BOUNDS = (0.01, 0.001)
"""Errors of the performance in body lengths for which the cheapest setting is named."""

JUDGED = "gait"
"""The scene that settings are judged by.

Not the whole trial: the gait amplifies any difference, rounding included, and after 60 s no step helps. Of its
5 s it is the median over the trials, since the mean is that of the few that have been amplified already.
"""


@dataclass(frozen=True)
class Goal:
    """The cheapest setting that is at least as exact as the paper's engine on one lane, and that engine's row."""

    ours: Row
    theirs: Row

    @property
    def ratio(self) -> float:
        """How many times less time a simulated second takes."""
        return self.theirs.seconds / self.ours.seconds


def whole(rows: Sequence[Row], scene: str) -> list[Row]:
    """The rows that stand for a scene: of all morphologies if it has several."""
    mine = [row for row in rows if row.scene == scene]
    pooled = [row for row in mine if row.morphology == POOLED]
    return pooled or mine


def cheapest(rows: Sequence[Row], bound: float, measure: str = "performance_median") -> Row | None:
    """The cheapest row whose performance error is below a bound, body lengths; at equal cost the shipped theta."""
    good = [r for r in whole(rows, JUDGED) if getattr(r, measure) < bound and math.isfinite(r.seconds)]
    return min(good, key=_cost, default=None)


def _cost(row: Row) -> tuple[float, bool, float]:
    return row.seconds, not row.usual, row.error


def goal(rows: Sequence[Row], measure: str = "performance_median") -> Goal | None:
    """Compare with the paper's engine on one lane, by an error or by ``rank``; None if it was not measured."""
    judged = [r for r in whole(rows, JUDGED) if math.isfinite(r.error + r.seconds)]
    theirs = next((r for r in judged if r.width == 1), None)
    if theirs is None:
        return None
    sign = -1.0 if measure == "rank" else 1.0
    as_good = [r for r in judged if sign * getattr(r, measure) <= sign * getattr(theirs, measure)]
    return Goal(min(as_good, key=_cost, default=theirs), theirs)


def named(row: Row) -> str:
    """A setting in words, without its step."""
    knob = f" {row.iterations} iterations" if row.iterations else f" θ {row.theta:g}" if row.theta else ""
    return f"{row.integrator} {row.precision}{knob}{' one lane' if row.width == 1 else ''}"


def sentence(rows: Sequence[Row]) -> str:
    """The one sentence: the cheapest settings below 1 % and below 0.1 % of performance error."""
    judged = whole(rows, JUDGED)
    if not judged:
        return f"No setting is named: that takes the scene {JUDGED}."
    parts = [_best(rows, bound, first=bound == BOUNDS[0]) for bound in BOUNDS]
    trials, duration = judged[0].trials, judged[0].duration
    about = f"By the median error of a gait's displacement over {trials} trials of {duration:g} s"
    return f"{about}, {'; '.join(parts)}{_amplified(rows)}."


def _best(rows: Sequence[Row], bound: float, *, first: bool) -> str:
    below = f"below {percent(bound)} of a body length"
    best = cheapest(rows, bound)
    if best is None:
        return f"no setting is {below}"
    cost = f"{best.seconds * 1e6:,.0f} µs a simulated second and lane{' on one thread' if first else ''}"
    error = f"{percent(best.error)}, 95th percentile {percent(best.performance_p95)}"
    return f"the cheapest setting {below} is {named(best)} at dt {best.dt:.3g} s ({error}; {cost})"


def _amplified(rows: Sequence[Row]) -> str:
    late = [r for r in whole(rows, "long-gait") if math.isfinite(r.error)]
    if not late:
        return ""
    least = min(late, key=lambda r: r.error)
    when = f"; after {least.duration:g} s, when the gait has amplified all differences"
    return f"{when}, none is below {percent(least.error)}" if least.error >= BOUNDS[0] else ""


def percent(error: float) -> str:
    """An error in body lengths as a percentage with two digits that count."""
    return f"{100 * error:.2g} %" if error < 0.995 else f"{100 * error:.0f} %"
