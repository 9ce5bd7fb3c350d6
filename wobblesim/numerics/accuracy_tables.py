"""The tables of `accuracy`, in words: for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from wobblesim.numerics.accuracy import PERFORMING, Agreement, Row, front
from wobblesim.numerics.accuracy_sensitivity import Sensitivity
from wobblesim.numerics.accuracy_verdict import BOUNDS, cheapest, named, percent, whole

Column = tuple[str, Callable[[Row], str]]


def number(value: float, digits: int = 2) -> str:
    """A number with so many digits that count; a dash if it is none."""
    if not math.isfinite(value):
        return "–"
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    places = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(0, places)}f}"


COST: list[Column] = [
    ("µs/s", lambda r: number(r.seconds * 1e6, 3)),
    ("lost", lambda r: str(r.failures)),
]
STEP: Column = ("dt (s)", lambda r: f"{r.dt:.3g}")
SMOOTH: list[Column] = [
    STEP,
    ("node (u)", lambda r: number(r.node_error)),
    ("path (u)", lambda r: number(r.path_error)),
    ("energy", lambda r: number(r.energy_error)),
    *COST,
]
WITH_FLOOR: list[Column] = [column for column in SMOOTH if column[0] != "energy"]
PERFORMANCE: list[Column] = [
    STEP,
    ("median", lambda r: number(r.performance_median)),
    ("95 %", lambda r: number(r.performance_p95)),
    ("mean", lambda r: number(r.performance_mean)),
    ("bias", lambda r: number(r.performance_bias)),
    ("rank", lambda r: "–" if math.isnan(r.rank) else f"{r.rank:.3f}"),
    ("node (u)", lambda r: number(r.node_error)),
    *COST,
]


def scene_table(rows: Sequence[Row], scene: str) -> tuple[list[str], list[list[str]]]:
    """Names of the columns and cells of a scene's table; ``*`` marks the front, ``=`` the shipped default."""
    columns = PERFORMANCE if scene in PERFORMING else WITH_FLOOR if scene == "drop" else SMOOTH
    mine = [row for row in whole(rows, scene) if not row.note]
    best = {id(row) for row in front(mine)}
    cells = [[_setting(row, id(row) in best), *(show(row) for _, show in columns)] for row in sorted(mine, key=_order)]
    return ["setting", *(name for name, _ in columns)], cells


def _setting(row: Row, on_front: bool) -> str:
    marks = f"{'*' if on_front else ''}{'=' if row.shipped else ''}"
    words = named(row).replace(" iterations", " it.").replace("one lane", "1 lane").replace(" float", " f")
    return f"{words} {marks}".rstrip()


def _order(row: Row) -> tuple[object, ...]:
    return row.integrator, row.width or 0, row.iterations or 0, row.theta or 0.0, row.precision, -row.dt


def notes(rows: Sequence[Row], scene: str) -> list[str]:
    """A line for each reason why a setting has no figures."""
    reasons: dict[str, str] = {}
    for row in whole(rows, scene):
        if row.note:
            reasons.setdefault(row.note, f"{row.integrator} at dt {row.dt:.3g}: {row.note}")
    return list(reasons.values())


def reference_line(rows: Sequence[Row], scene: str) -> str:
    """What the scene is compared with, and how far that may be off."""
    found: dict[str, str] = {}
    for row in whole(rows, scene):
        if row.reference:
            found[row.reference] = f"{row.reference} (off by {_doubt(row)})"
    return "reference: " + "; ".join(found.values())


def _doubt(row: Row) -> str:
    if row.scene in PERFORMING:
        return f"{number(row.reference_performance_error)} body lengths"
    return f"{number(row.reference_path_error)} u"


MEASURES = {"median": "performance_median", "mean": "performance_mean", "95th percentile": "performance_p95"}


def cheapest_table(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """The cheapest settings, were another measure of the gait's error taken."""
    return ["by the", *(f"below {percent(bound)}" for bound in BOUNDS)], [
        [words, *(_briefly(cheapest(rows, bound, measure)) for bound in BOUNDS)] for words, measure in MEASURES.items()
    ]


def _briefly(row: Row | None) -> str:
    return f"{named(row)}, dt {row.dt:.3g} s ({number(row.seconds * 1e6, 3)} µs/s)" if row else "none"


def agreement_table(agreements: Sequence[Agreement]) -> tuple[list[str], list[list[str]]]:
    """How far the references of the two laws of contact agree."""
    columns = ["scene", "morphology", "rank", "mean difference", "median distance", "mean distance"]
    return columns, [
        [a.scene, a.morphology, "–" if math.isnan(a.rank) else f"{a.rank:.2f}",
         *(number(v) for v in (a.mean_difference, a.median_distance, a.mean_distance))]
        for a in agreements
    ]  # fmt: skip


def sensitivity_table(found: Sequence[Sensitivity]) -> tuple[list[str], list[list[str]]]:
    """How far next to nothing moves the end of a gait."""
    columns = ["change", "after (s)", "median", "95 %", "largest"]
    return columns, [[s.change, f"{s.duration:g}", *(number(v) for v in (s.median, s.p95, s.largest))] for s in found]
