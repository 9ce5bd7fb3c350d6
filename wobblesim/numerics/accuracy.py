"""Error against run time: every integrator, step, number of iterations, theta and precision, on every scene.

A row is one setting on one scene. What is wrong with its solution is measured against a reference (`reference.py`),
what it costs on one thread, on full blocks of lanes (`accuracy_timing.py`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from wobblesim.numerics.accuracy_timing import seconds_per_second
from wobblesim.numerics.reference import Equations, Reference, by_steps, reference_of
from wobblesim.numerics.scenes import SCENES, Case
from wobblesim.numerics.throughput import conditions
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics
from wobblesim.physics.simulate import Trials

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]

POOLED = "all"
"""Name of the row that pools all morphologies of a scene."""

LEAST_RANKED = 10
"""Fewer behaviours have no ranking worth a number."""

KNOBS: dict[str, tuple[str, tuple[float, ...]]] = {"midpoint": ("theta", (0.5, 0.8)), "impulse": ("iterations", (20,))}
"""What else than step and precision an integrator can be set to, and values to try beside the default."""

KNOB_STEPS = (0.04, 0.02, 0.01, 0.005)
"""Steps that the other values of a knob are tried at, beside the shipped one, s."""

GOAL = Physics(integrator="impulse", dt=0.005, iterations=5, precision="float64", refinements=0)
"""Run one lane at a time, the paper's engine and step: what the program is measured against."""


@dataclass(frozen=True)
class Grid:
    """Steps that a scene is tried at, in s, longest first.

    `bounded` are those for integrators with a limit, on the robot; `finest` is the step of the reference where there
    is a floor.
    """

    steps: tuple[float, ...]
    bounded: tuple[float, ...]
    finest: float = math.nan


def _halved(dt: float, times: int) -> tuple[float, ...]:
    return tuple(dt / 2**j for j in range(times + 1))


FULL = {
    "oscillator": Grid(_halved(0.04, 6), _halved(0.04, 6)),
    "chain": Grid(_halved(0.04, 6), _halved(0.04, 6)),
    "flight": Grid(_halved(0.04, 6), _halved(4e-4, 2)),
    "drop": Grid(_halved(0.04, 6), _halved(4e-4, 2), finest=2e-5),
    "gait": Grid((*_halved(0.04, 5), 1 / 30, 0.025, 1 / 60, 0.0125), _halved(4e-4, 1), finest=1e-4),
    "long-gait": Grid(_halved(0.04, 5), (2e-4,), finest=0.000625),
}
SHORT = {
    "oscillator": Grid(_halved(0.02, 2), _halved(0.02, 2)),
    "chain": Grid(_halved(0.02, 2), _halved(0.005, 1)),
    "flight": Grid(_halved(0.02, 2), (4e-4,)),
    "drop": Grid(_halved(0.02, 2), (4e-4,), finest=0.000625),
    "gait": Grid(_halved(0.02, 2), (), finest=0.000625),
    "long-gait": Grid(_halved(0.02, 2), (), finest=0.00125),
}
MOST_LANE_STEPS = 4e7
"""A setting that needs more of them on one scene is left out: it would take minutes and show nothing new."""


@dataclass(frozen=True)
class Row:
    """One setting on one scene.

    Attributes
    ----------
    scene, morphology : str
        The morphology is ``all`` where several are pooled.
    duration : float
        s.
    integrator, dt, precision : str, float, str
    iterations, theta : int or None, float or None
        None for an integrator that has no such thing.
    width : int or None
        Lanes a block; None for a full one.
    trials, steps : int
        Steps of one trial.
    node_error, path_error : float
        Root mean square over the free nodes, at the end and over all frames, u; median over the trials.
    energy_error : float
        Of the energy near the end, over the most that motion and springs hold; median over the trials. NaN with a
        floor, whose springs hold energy too.
    performance_median, performance_p95, performance_mean : float
        Of the absolute error of the displacement over the trials, body lengths. NaN where there is no performance.
    performance_bias, performance_bias_error : float
        Mean of the signed error, and its standard error.
    rank : float
        Spearman's correlation of the displacements with the reference's (mean over the morphologies).
    failures, limited : int
        Trials that diverged, and that a limiter has touched. One failure makes all errors and the time NaN.
    seconds : float
        Run time of a simulated second of one lane, s.
    reference : str
    reference_node_error, reference_path_error, reference_performance_error : float
        How far the reference may be off: what half its resolution changes (medians as above).
    spread : float
        Standard deviation of the reference's displacements, body lengths (mean over the morphologies).
    note : str
        Why there are no figures, where there are none.
    """

    scene: str
    morphology: str
    duration: float
    integrator: str
    dt: float
    precision: str
    iterations: int | None
    theta: float | None
    width: int | None
    trials: int
    steps: int
    node_error: float = math.nan
    path_error: float = math.nan
    energy_error: float = math.nan
    performance_median: float = math.nan
    performance_p95: float = math.nan
    performance_mean: float = math.nan
    performance_bias: float = math.nan
    performance_bias_error: float = math.nan
    rank: float = math.nan
    failures: int = 0
    limited: int = 0
    seconds: float = math.nan
    reference: str = ""
    reference_node_error: float = math.nan
    reference_path_error: float = math.nan
    reference_performance_error: float = math.nan
    spread: float = math.nan
    note: str = ""

    @property
    def error(self) -> float:
        """The error that this scene is about: of the performance if it has one, else of the path.

        Not of the nodes at the end: what swings may pass the right place at the right time by chance.
        """
        return self.performance_median if self.scene in PERFORMING else self.path_error

    @property
    def usual(self) -> bool:
        """Whether iterations and theta stand as shipped."""
        default = Physics()
        return self.iterations in (None, default.iterations) and self.theta in (None, default.theta)

    @property
    def shipped(self) -> bool:
        """Whether this is the shipped default."""
        default = Physics()
        same = (self.integrator, self.dt, self.precision) == (default.integrator, default.dt, default.precision)
        return same and self.usual and self.width is None


PERFORMING = ("gait", "long-gait")
"""Scenes whose displacement is a performance."""


@dataclass(frozen=True)
class Agreement:
    """How far the references of the rigid and the compliant contact law agree on the displacement.

    Differences are rigid minus compliant, body lengths; `rank` is Spearman's correlation.
    """

    scene: str
    morphology: str
    trials: int
    rank: float
    mean_difference: float
    median_distance: float
    mean_distance: float


@dataclass(frozen=True)
class SceneResult:
    """All rows of one scene, and the agreement of the laws where there is contact."""

    scene: str
    rows: list[Row]
    agreements: list[Agreement]


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of the trials of one case, (n_trials,) each; NaN where a trial diverged."""

    node: Floats
    path: Floats
    energy: Floats
    displacement: Floats
    reference: Reference
    failures: int
    limited: int


def measure(
    scenes: Sequence[str] | None = None,
    integrators: Sequence[str] | None = None,
    *,
    short: bool = False,
    threads: int | None = None,
) -> Iterator[SceneResult]:
    """Measure errors and run times, scene by scene.

    Parameters
    ----------
    scenes, integrators : sequence of str, optional
        Names of `SCENES` and of `INTEGRATORS`; all if not given.
    short : bool
        Fewer settings, trials and seconds: to see that everything works, not to judge by.
    threads : int, optional
        For what is not timed; all that Numba may use if not given.
    """
    for name in scenes or tuple(SCENES):
        yield _Bench(name, short, threads).result(tuple(integrators or INTEGRATORS))


def accuracy(
    scenes: Sequence[str] | None = None,
    integrators: Sequence[str] | None = None,
    *,
    short: bool = False,
    threads: int | None = None,
) -> pd.DataFrame:
    """Measure errors and run times, as a table: the options of `measure`, the columns of `to_frame`."""
    results = measure(scenes, integrators, short=short, threads=threads)
    return to_frame([row for result in results for row in result.rows])


def to_frame(rows: Sequence[Row]) -> pd.DataFrame:
    """The rows as a pandas DataFrame, one column an attribute of `Row`, and four more.

    ``error`` is the one that the scene is about, ``front`` tells whether no cheaper row of the same scene and
    morphology is as exact, ``usual`` whether iterations and theta stand as shipped, and ``shipped`` whether all does.
    """
    import pandas as pd

    made = pd.DataFrame([asdict(row) for row in rows], columns=[f.name for f in fields(Row)])
    made["error"] = np.array([row.error for row in rows], dtype=np.float64)
    best = {id(row) for row in front(rows)}
    made["front"] = np.array([id(row) in best for row in rows], dtype=np.bool_)
    made["usual"] = np.array([r.usual for r in rows], dtype=np.bool_)
    made["shipped"] = np.array([r.shipped for r in rows], dtype=np.bool_)
    return made.astype({"iterations": "Int64", "width": "Int64", "theta": "float64"})


def front(rows: Sequence[Row]) -> list[Row]:
    """The rows that no cheaper row of their scene and morphology equals in error, cheapest first in each."""
    best: dict[tuple[str, str], list[Row]] = {}
    for row in sorted((r for r in rows if math.isfinite(r.error + r.seconds)), key=lambda r: (r.seconds, r.error)):
        found = best.setdefault((row.scene, row.morphology), [])
        if not found or row.error < found[-1].error:
            found.append(row)
    return [row for found in best.values() for row in found]


def measured_with() -> dict[str, str]:
    """The machine, the versions and the day."""
    return {**conditions(), "date": datetime.now(UTC).date().isoformat()}


def settings_of(scene: str, integrator: str, *, short: bool = False) -> list[Physics]:
    """The settings of an integrator that a scene is tried with, shortest steps first."""
    grid = (SHORT if short else FULL)[scene]
    default = Physics(integrator=integrator, refinements=0)
    steps = set(grid.steps if INTEGRATORS[integrator].stable_when_stiff else grid.bounded)
    if integrator == Physics().integrator:
        steps.add(default.dt)
    precisions = (default.precision,) if short and integrator == Physics().integrator else ("float32", "float64")
    precisions = ("float64",) if short and integrator != Physics().integrator else precisions
    found = [replace(default, dt=dt, precision=precision) for precision in precisions for dt in sorted(steps)]
    return found + ([] if short else _variants(default, sorted(steps & {*KNOB_STEPS, Physics().dt})))


def _variants(default: Physics, steps: Sequence[float]) -> list[Physics]:
    """The other values of an integrator's knob, at its longest steps and in the shipped precision."""
    knob, values = KNOBS.get(default.integrator, ("", ()))
    other = [value for value in values if value != getattr(default, knob)]
    return [replace(default, dt=dt, **{knob: value}) for value in other for dt in steps]


class _Bench:
    """One scene with its cases, references and settings."""

    def __init__(self, scene: str, short: bool, threads: int | None) -> None:
        self.scene, self.short = scene, short
        self.cases = SCENES[scene](short)
        self.finest = (SHORT if short else FULL)[scene].finest
        # A few results are kept, since the references' runs are rows as well.
        self.runs = [
            functools.lru_cache(maxsize=8)(functools.partial(by_steps, c, threads=threads)) for c in self.cases
        ]

    def result(self, integrators: Sequence[str]) -> SceneResult:
        settings = [s for name in integrators for s in settings_of(self.scene, name, short=self.short)]
        notes: dict[Physics, str] = {s: note for s in settings if (note := self._left_out(s))}
        tried = [s for s in settings if s not in notes]
        errors: dict[Physics, list[_Errors]] = {s: [] for s in tried}
        agreements = []
        for case, run in zip(self.cases, self.runs, strict=True):
            references = self._references(case, run, integrators)
            agreements += self._agreement(case, references)
            for setting in tried:
                try:
                    trials = run(setting)
                except ValueError as refusal:
                    notes.setdefault(setting, str(refusal).split(";")[0])
                    continue
                errors[setting].append(_errors(case, trials, references[INTEGRATORS[setting.integrator].contact]))
            run.cache_clear()
        done = [s for s in tried if s not in notes]
        timed = [(s, None) for s in done] + ([(GOAL, 1)] if GOAL in done and self.scene in PERFORMING else [])
        pace = {"repeats": 1, "most": 16_000} if self.short else {"repeats": 4, "most": 64_000}
        cost = seconds_per_second(self.cases[0], timed, **pace)
        rows = [row for s, width in timed for row in self._rows(s, width, errors[s], cost[s, width])]
        rows += [self._row(s, None, self._name(), self._trials(), note=note) for s, note in notes.items()]
        return SceneResult(self.scene, rows, agreements)

    def _references(
        self, case: Case, run: Callable[[Physics], Trials], integrators: Sequence[str]
    ) -> dict[str, Reference]:
        laws = {INTEGRATORS[name].contact for name in integrators}
        if case.has_floor:
            return {law: reference_of(case, law, run, self.finest) for law in sorted(laws)}
        return dict.fromkeys(laws, reference_of(case, "", run, self.finest))

    def _left_out(self, setting: Physics) -> str:
        lane_steps = self._trials() * self.cases[0].duration / setting.dt
        if lane_steps <= MOST_LANE_STEPS:
            return ""
        return f"left out: {lane_steps / 1e6:.0f} million steps of one robot would take minutes"

    def _agreement(self, case: Case, references: dict[str, Reference]) -> list[Agreement]:
        if not (case.has_floor and {"rigid", "compliant"} <= references.keys()):
            return []
        rigid, compliant = references["rigid"].displacement, references["compliant"].displacement
        apart = rigid - compliant
        return [
            Agreement(
                self.scene, case.name, len(apart), _rank(rigid, compliant), float(apart.mean()),
                float(np.median(np.abs(apart))), float(np.abs(apart).mean()),
            )
        ]  # fmt: skip

    def _rows(self, setting: Physics, width: int | None, errors: list[_Errors], seconds: float) -> list[Row]:
        """A row for each case, and one that pools them if there are several."""
        named = [(case.name, [e]) for case, e in zip(self.cases, errors, strict=True)]
        named += [(POOLED, errors)] if len(errors) > 1 else []
        return [
            self._row(setting, width, name, sum(len(e.node) for e in some), **_figures(self.scene, some, seconds))
            for name, some in named
        ]

    def _row(self, setting: Physics, width: int | None, morphology: str, trials: int, **figures: Any) -> Row:
        knob = KNOBS.get(setting.integrator, ("", ()))[0]
        return Row(
            scene=self.scene, morphology=morphology, duration=self.cases[0].duration, integrator=setting.integrator,
            dt=setting.dt, precision=setting.precision, iterations=setting.iterations if knob == "iterations" else None,
            theta=setting.theta if knob == "theta" else None, width=width, trials=trials,
            steps=round(self.cases[0].duration / setting.dt), **figures,
        )  # fmt: skip

    def _name(self) -> str:
        return POOLED if len(self.cases) > 1 else self.cases[0].name

    def _trials(self) -> int:
        return sum(len(case.behaviours) for case in self.cases)


def _errors(case: Case, trials: Trials, reference: Reference) -> _Errors:
    assert trials.positions is not None
    lost = trials.status == "diverged"
    moved = ~case.body.fixed
    positions = np.where(lost, np.nan, trials.positions)
    return _Errors(
        node=_rms(positions[-1:, moved], reference.positions[-1:, moved]),
        path=_rms(positions[:, moved], reference.positions[:, moved]),
        energy=_energy_error(case, positions, reference),
        displacement=np.where(lost, np.nan, trials.displacement),
        reference=reference,
        failures=int(np.count_nonzero(lost)),
        limited=int(np.count_nonzero(trials.status == "limited")),
    )


def _rms(positions: Floats, wanted: Floats) -> Floats:
    """Root mean square over frames and nodes of the distance, (n_trials,) u."""
    apart = positions - wanted
    return np.sqrt((apart**2).sum(axis=2).mean(axis=(0, 1)))


def _energy_error(case: Case, positions: Floats, reference: Reference) -> Floats:
    """Error of the energy one frame before the end, relative, (n_trials,).

    Trials do not keep velocities. They are taken from the frames before and after, alike for both solutions, so
    that the difference of the energies is not due to that.
    """
    if case.has_floor:
        return np.full(positions.shape[-1], np.nan)
    equations, times = Equations.of(case), case.times
    frames = range(1, len(times) - 1)
    most = np.max([_energies(equations, times, reference.positions, i)[0] for i in frames], axis=0)
    ours, theirs = (sum(_energies(equations, times, p, len(times) - 2)) for p in (positions, reference.positions))
    return np.abs(ours - theirs) / most


def _energies(equations: Equations, times: Floats, positions: Floats, i: int) -> tuple[Floats, Floats]:
    velocity = (positions[i + 1] - positions[i - 1]) / (times[i + 1] - times[i - 1])
    return equations.energy(times[i], positions[i].astype(np.float64), velocity)


def _figures(scene: str, errors: list[_Errors], seconds: float) -> dict[str, Any]:
    """What a row says of the trials of some cases."""
    figures: dict[str, Any] = {
        "failures": sum(e.failures for e in errors),
        "limited": sum(e.limited for e in errors),
        "reference": errors[0].reference.source,
        "reference_node_error": _median([_rms(e.reference.coarser[-1:], e.reference.positions[-1:]) for e in errors]),
        "reference_path_error": _median([_rms(e.reference.coarser, e.reference.positions) for e in errors]),
    }
    if scene in PERFORMING:
        apart = [e.reference.coarser_displacement - e.reference.displacement for e in errors]
        figures["reference_performance_error"] = _median([np.abs(a) for a in apart])
        figures["spread"] = float(np.mean([np.std(e.reference.displacement) for e in errors]))
    if figures["failures"]:
        return figures
    figures |= {name: _median([getattr(e, name) for e in errors]) for name in ("node", "path", "energy")}
    for name in ("node", "path", "energy"):
        figures[f"{name}_error"] = figures.pop(name)
    return figures | {"seconds": seconds} | (_performance(errors) if scene in PERFORMING else {})


def _performance(errors: list[_Errors]) -> dict[str, float]:
    wrong = np.concatenate([e.displacement - e.reference.displacement for e in errors])
    size = np.abs(wrong)
    return {
        "performance_median": float(np.median(size)),
        "performance_p95": float(np.percentile(size, 95)),
        "performance_mean": float(size.mean()),
        "performance_bias": float(wrong.mean()),
        "performance_bias_error": float(wrong.std(ddof=1) / math.sqrt(len(wrong))),
        "rank": float(np.mean([_rank(e.displacement, e.reference.displacement) for e in errors])),
    }


def _median(parts: list[Floats]) -> float:
    return float(np.median(np.concatenate(parts)))


def _rank(one: Floats, other: Floats) -> float:
    return float(spearmanr(one, other).statistic) if len(one) >= LEAST_RANKED else math.nan
