"""How far a dimension may wobble at a step: the table behind `numerics.safety`, and theta against divergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from wobblesim.learning.wobble import DIMENSIONS
from wobblesim.numerics.stability_box import GAINS, TOLERANCE, Progress, Trying, behaviours_of, cells
from wobblesim.physics.kernels import kernel_hash
from wobblesim.physics.scene import Floor, Physics, Scene
from wobblesim.physics.simulate import simulate
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology
from wobblesim.robot.starfish import starfish

FACTORS = (
    0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0,
    1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.8, 2.0, 3.0, 5.0, 10.0, 20.0,
)  # fmt: skip


def factor_cells(
    settings: Sequence[Physics], steps: Sequence[float], factors: Sequence[float], trying: Trying,
    dimensions: Sequence[str] = DIMENSIONS, say: Progress = lambda _: None,
) -> pd.DataFrame:  # fmt: skip
    """One row a setting, step, dimension and factor; the columns of the box, and these two."""
    body, rows = starfish(), []
    for physics in settings:
        for dimension in dimensions:
            say(f"{physics.integrator}: {len(factors)} factors on {dimension}, {len(steps)} steps")
            for factor in factors:
                morphology = Morphology(**{dimension: factor})
                found = cells(body, morphology, physics, steps, trying)
                rows += [{"dimension": dimension, "factor": factor, **row} for row in found]
    return pd.DataFrame(rows)


def is_stable(cells: pd.DataFrame) -> pd.Series:
    """Whether no trial diverged and the drop gained no energy; limited trials say so themselves."""
    return (cells["diverged"] == 0) & (cells["gain"] <= GAINS)


def is_converged(cells: pd.DataFrame) -> pd.Series:
    """Whether it is stable, and the step accurate enough."""
    return is_stable(cells) & (cells["median_difference"] <= TOLERANCE)


def around_the_adult(factors: Sequence[float], good: Sequence[bool]) -> tuple[float, float] | None:
    """Ends of the run of good factors that holds 1; None if 1 is not good."""
    order = np.argsort(factors)
    factor, fine = np.asarray(factors)[order], np.asarray(good, dtype=bool)[order]
    adult = int(np.flatnonzero(factor == 1.0)[0])
    if not fine[adult]:
        return None
    bad = np.flatnonzero(~fine)
    first, last = bad[bad < adult].max(initial=-1) + 1, bad[bad > adult].min(initial=len(factor)) - 1
    return float(factor[first]), float(factor[last])


def ranges(cells: pd.DataFrame) -> pd.DataFrame:
    """Safe factors: one row an integrator, step and dimension, NaN where the adult itself is not safe."""
    judged = cells.assign(stable=is_stable(cells), converged=is_converged(cells))
    rows = []
    for (integrator, dt, dimension), of in judged.groupby(["integrator", "dt", "dimension"], sort=False):
        row = {"integrator": integrator, "dt": dt, "dimension": dimension}
        for kind in ("stable", "converged"):
            low, high = around_the_adult(of["factor"].tolist(), of[kind].tolist()) or (math.nan, math.nan)
            row |= {f"{kind}_low": low, f"{kind}_high": high, f"{kind}_amplitude": min(1.0 - low, high - 1.0)}
        rows.append(row)
    return pd.DataFrame(rows)


def table_of(found: pd.DataFrame, trying: Trying, factors: Sequence[float]) -> dict[str, Any]:
    """The content of the committed file: conditions, and safe ranges by integrator, step and dimension."""
    safe: dict[str, Any] = {}
    for row in found.to_dict("records"):
        known = None if math.isnan(row["stable_low"]) else [row["stable_low"], row["stable_high"]]
        safe.setdefault(row["integrator"], {}).setdefault(f"{row['dt']:g}", {})[row["dimension"]] = known
    physics, gait = Physics(), Gait()
    conditions = {
        "robot": "starfish", "gait": [gait.period, gait.max_amplitude], "gravity": list(Scene().gravity_vector),
        "floor": asdict(Floor()), "precision": physics.precision, "theta": physics.theta,
        "iterations": physics.iterations, "behaviours": trying.behaviours, "seconds": trying.seconds,
        "kernels": kernel_hash(),
    }  # fmt: skip
    return {"conditions": conditions, "factors": list(factors), "safe": safe}


# --- theta ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Thetas:
    """What is tried to choose theta; `seconds` is the length of a trial."""

    thetas: Sequence[float]
    steps: Sequence[float]
    masses: Sequence[float]
    behaviours: int
    seconds: float


def theta_counts(trying: Thetas, say: Progress = lambda _: None) -> pd.DataFrame:
    """Trials that diverge: one row a step, mass and floor, with the stiffness per unit of mass or one for all nodes.

    `diverged` is without repeats, `refined` and `still_diverged` with the shipped number of repeats at half the step.
    """
    rows = []
    for theta in trying.thetas:
        say(f"midpoint theta {theta:g}: {trying.behaviours} behaviours of {trying.seconds:g} s")
        for dt in trying.steps:
            for mass in trying.masses:
                floors = {"per mass": Floor()}
                if mass != 1.0:
                    floors["one for all"] = Floor(stiffness=Floor().stiffness / mass)
                rows += [
                    {"theta": theta, "dt": dt, "mass": mass, "floor": name, "trials": trying.behaviours}
                    | _counts(trying, theta, dt, mass, floor)
                    for name, floor in floors.items()
                ]
    return pd.DataFrame(rows)


def _counts(trying: Thetas, theta: float, dt: float, mass: float, floor: Floor) -> dict[str, int]:
    body = starfish()
    behaviours = behaviours_of(body, trying.behaviours)

    def counts(physics: Physics) -> dict[str, int]:
        status = simulate(
            body, behaviours, morphology=Morphology(mass=mass), scene=Scene(floor=floor), physics=physics,
            duration=trying.seconds,
        ).status  # fmt: skip
        return {name: int(np.count_nonzero(status == name)) for name in ("diverged", "refined")}

    physics = Physics(integrator="midpoint", theta=theta, dt=dt)
    alone = counts(replace(physics, refinements=0))
    repeated = counts(physics) if alone["diverged"] else {"diverged": 0, "refined": 0}
    return {
        "diverged": alone["diverged"], "refined": repeated["refined"], "still_diverged": repeated["diverged"]
    }  # fmt: skip
