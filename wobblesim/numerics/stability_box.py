"""The morphology box: which mass, stiffness and size an integrator stands at which step.

A cell is one morphology at one step. It is classified by the first rule that holds (`classify`):

- ``diverged``: a trial of the gait diverged, unless
- ``too fast``: of those trials that are repeated at dt/4, at least as many diverge there, one at least: what leaves the
  bounds is the motion and not the method;
- ``gains energy``: dropped from 100 u with motors off, the robot has at some moment more energy than at the start, by
  more than the part `GAINS` (numerics/stability_energy.py);
- ``limited``: a limiter acted in a trial of the gait;
- ``not converged``: the median over the behaviours of |displacement(dt) - displacement(dt/4)| is above `TOLERANCE`;
- ``ok``.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wobblesim.numerics.stability_energy import above_start, energy_of_a_drop, largest_rise
from wobblesim.physics.contract import system_of
from wobblesim.physics.explicit import stability_limit
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology
from wobblesim.robot.starfish import starfish

CLASSES = ("ok", "not converged", "limited", "gains energy", "too fast", "diverged")
"""From harmless to useless."""

GAINS = 0.05
TOLERANCE = 0.02  # body lengths (EM-2)
SEED = 11
FAR = 1e8  # u/s; e L sqrt(k/m) of the lightest, stiffest robot's muscles is 1e5

Progress = Callable[[str], None]


def classify(diverged: int, again: tuple[int, int], gain: float, limited: int, difference: float) -> str:
    """The class of a cell; a gain or difference that is not a number counts as infinite.

    `again` holds the diverged of the repeated trials, at the step and at a quarter of it.
    """
    if diverged:
        return "too fast" if again[1] >= max(again[0], 1) else "diverged"
    if not gain <= GAINS:
        return "gains energy"
    if limited:
        return "limited"
    return "ok" if difference <= TOLERANCE else "not converged"


@dataclass(frozen=True)
class Trying:
    """How long a cell is tried.

    Attributes
    ----------
    behaviours, seconds : int, float
        Random behaviours, the same in every cell, and the length of their trials.
    compared, compared_seconds : int, float
        How many of them, for how long, are compared with a quarter of the step; also the length of a drop.
    """

    behaviours: int
    seconds: float
    compared: int
    compared_seconds: float


@dataclass(frozen=True)
class Box:
    """Factors, whose product are the cells, and steps (s)."""

    mass: Sequence[float]
    stiffness: Sequence[float]
    size: Sequence[float]
    steps: Sequence[float]

    @property
    def morphologies(self) -> list[Morphology]:
        """All cells of one step."""
        return [Morphology(mass=m, stiffness=k, size=s) for s in self.size for k in self.stiffness for m in self.mass]


def behaviours_of(body: Body, count: int) -> NDArray[np.float64]:
    """Random behaviours (count, 2 n_groups), the same every time."""
    return np.random.default_rng(SEED).random((count, 2 * body.n_groups))


def box(box: Box, settings: Sequence[Physics], trying: Trying, say: Progress = lambda _: None) -> pd.DataFrame:
    """One row a setting (whose own step is not used), step and cell."""
    body, rows = starfish(), []
    for physics in settings:
        say(f"{physics.integrator} {physics.precision}: {len(box.morphologies)} morphologies, {len(box.steps)} steps")
        for morphology in box.morphologies:
            rows += cells(body, morphology, physics, box.steps, trying)
    return pd.DataFrame(rows)


def cells(
    body: Body, morphology: Morphology, physics: Physics, steps: Sequence[float], trying: Trying
) -> list[dict[str, Any]]:
    """The cells of one morphology, a row each."""
    # The trials at a quarter of one step are those of another.
    trials = functools.cache(functools.partial(_trials, body, morphology, physics))
    return [
        {**asdict(morphology), **_cell(body, morphology, replace(physics, dt=dt, refinements=0), trials, trying)}
        for dt in steps
    ]


def _trials(body: Body, morphology: Morphology, physics: Physics, dt: float, count: int, seconds: float) -> Trials:
    return simulate(
        body, behaviours_of(body, count), morphology=morphology, physics=replace(physics, dt=dt, refinements=0),
        duration=seconds,
    )  # fmt: skip


def _cell(
    body: Body, morphology: Morphology, physics: Physics, trials: Callable[..., Trials], trying: Trying
) -> dict[str, Any]:
    dt = physics.dt
    status = trials(dt, trying.behaviours, trying.seconds).status
    diverged, limited = (int(np.count_nonzero(status == name)) for name in ("diverged", "limited"))
    coarse, fine = (trials(h, trying.compared, trying.compared_seconds) for h in (dt, dt / 4))
    again = int(np.count_nonzero(coarse.status == "diverged")), int(np.count_nonzero(fine.status == "diverged"))
    difference = np.nan_to_num(np.abs(coarse.displacement - fine.displacement), nan=np.inf)
    energies = energy_of_a_drop(body, morphology, physics, trying.compared_seconds)
    gain, median = above_start(energies), float(np.median(difference))
    return {
        "integrator": physics.integrator, "precision": physics.precision, "dt": dt, "trials": trying.behaviours,
        "diverged": diverged, "diverged_at_quarter": again[1], "limited": limited, "gain": gain,
        "rise": largest_rise(energies), "median_difference": median, "worst_difference": float(difference.max()),
        "within": float(np.mean(difference <= TOLERANCE)), "class": classify(diverged, again, gain, limited, median),
    }  # fmt: skip


def explicit_limits(box: Box) -> pd.DataFrame:
    """Largest stable step of `explicit` for each morphology: it refuses more, so nothing is run."""
    body, scene, rows = starfish(), Scene(), []
    for morphology in box.morphologies:
        limit, omega = stability_limit(system_of(body.adapted(morphology), scene, morphology.gravity))
        rows.append(
            {"mass": morphology.mass, "stiffness": morphology.stiffness, "size": morphology.size,
             "limit": float(limit), "omega": float(omega)}
        )  # fmt: skip
    return pd.DataFrame(rows)


def pull_across(morphology: Morphology, dt: float, amplitude: float) -> float:
    """Frequency across the strongest muscle, strained by the gait's amplitude, times the step.

    That is ``h sqrt(2 k e/m)``; no method that is run is stable beyond 2 (numerics/stability_spring.py).
    """
    adapted = starfish().adapted(morphology)
    k, m = adapted.stiffness[adapted.muscle_spring].max(), adapted.mass.min()
    return dt * math.sqrt(2.0 * k * amplitude / m)


def corner(box: Box, trying: Trying) -> pd.DataFrame:
    """Diverged trials of the lightest, stiffest robot of the box, over the step and the gait's amplitude.

    In double precision and adult size: on the floor with the shipped bound on the speed, then with one a hundred times
    beyond anything that moves (`FAR`), and so in free flight.
    """
    body, default = starfish(), Physics(integrator="midpoint", precision="float64", refinements=0)
    morphology, flight = Morphology(mass=min(box.mass), stiffness=max(box.stiffness)), Scene(gravity=0.0, floor=None)
    tried = {"shipped_bound": (Scene(), default.max_speed), "floor": (Scene(), FAR), "flight": (flight, FAR)}
    rows = []
    for dt in (default.dt, default.dt / 2, default.dt / 4, default.dt / 8):
        for part in (1.0, 0.5, 0.2):
            gait = Gait(max_amplitude=part * Gait().max_amplitude)
            counts = {
                name: np.count_nonzero(
                    simulate(
                        body, behaviours_of(body, trying.behaviours), morphology=morphology, scene=scene, gait=gait,
                        physics=replace(default, dt=dt, max_speed=bound), duration=trying.seconds,
                    ).status == "diverged"
                )
                for name, (scene, bound) in tried.items()
            }  # fmt: skip
            across = pull_across(morphology, dt, gait.max_amplitude)
            row = {"dt": dt, "amplitude": gait.max_amplitude, "across": across, "trials": trying.behaviours}
            rows.append(row | counts)
    return pd.DataFrame(rows)


def shares(cells: pd.DataFrame) -> pd.DataFrame:
    """Share of the cells in each class: one row an integrator, precision and step, one column a class."""
    keys = ["integrator", "precision", "dt"]
    counts = pd.crosstab([cells[key] for key in keys], cells["class"], normalize="index")
    counts = counts.reindex(columns=list(CLASSES), fill_value=0.0).sort_index(ascending=[False, True, False])
    return counts.reset_index().rename_axis(columns=None)
