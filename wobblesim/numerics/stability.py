"""Where each integrator breaks: theory beside measurement, on one spring and over the box of morphologies.

`measure` runs everything and returns tables; the command prints them, `stability_page` writes them as a page, and
`safety` looks up the one that is committed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from wobblesim.learning.wobble import DIMENSIONS
from wobblesim.numerics import stability_box, stability_safe, stability_scenes, stability_spring
from wobblesim.numerics.stability_box import Box, Progress, Trying
from wobblesim.numerics.stability_safe import FACTORS, Thetas
from wobblesim.physics.registry import INTEGRATORS
from wobblesim.physics.scene import Physics

Tables = dict[str, pd.DataFrame]

AUTHORS_STEP = 0.005  # s, of the engine behind the paper's results
RUN = tuple(name for name, integrator in INTEGRATORS.items() if integrator.stable_when_stiff)
"""Integrators that are run: `explicit` refuses all of these steps, and its limit is known."""


@dataclass(frozen=True)
class Effort:
    """How much is run.

    Attributes
    ----------
    box, box_trying : Box, Trying
    box_precisions : sequence of str
        Of the default integrator; the others run in the shipped precision.
    precisions : sequence of str
        Of chains, impacts and starts inside the floor.
    factors, safe_steps, safe_trying : sequence of float, sequence of float, Trying
        For the safe wobbles.
    thetas : Thetas
    """

    box: Box
    box_trying: Trying
    box_precisions: Sequence[str]
    precisions: Sequence[str]
    factors: Sequence[float]
    safe_steps: Sequence[float]
    safe_trying: Trying
    thetas: Thetas


def _steps(*others: float) -> tuple[float, ...]:
    """Steps from the coarsest, the shipped one among them."""
    return tuple(sorted({*others, Physics().dt}, reverse=True))


def full() -> Effort:
    """What the page in docs is made of: some minutes."""
    theta = Physics().theta
    return Effort(
        box=Box(np.geomspace(0.05, 20, 9).tolist(), np.geomspace(0.01, 1000, 11).tolist(), (0.2, 1.0, 3.0),
                _steps(0.02, 0.01, 0.005)),
        box_trying=Trying(behaviours=16, seconds=5.0, compared=16, compared_seconds=5.0),
        box_precisions=("float32", "float64"),
        precisions=("float32", "float64"),
        factors=FACTORS,
        safe_steps=_steps(0.04, 0.02, 0.01, 0.005, 0.0025),
        safe_trying=Trying(behaviours=32, seconds=20.0, compared=16, compared_seconds=5.0),
        thetas=Thetas(sorted({0.5, 0.55, 0.6, 0.7, theta}), (0.02, 0.01), (0.2, 0.5, 1.0), 256, seconds=60.0),
    )  # fmt: skip


def short() -> Effort:
    """A smoke test: every part, on little."""
    return Effort(
        box=Box((0.05, 1.0, 20.0), (0.01, 1.0, 1000.0), (1.0,), (Physics().dt,)),
        box_trying=Trying(behaviours=4, seconds=2.0, compared=4, compared_seconds=2.0),
        box_precisions=(Physics().precision,),
        precisions=("float64",),
        factors=(0.1, 0.5, 1.0, 1.5),
        safe_steps=(Physics().dt,),
        safe_trying=Trying(behaviours=4, seconds=2.0, compared=4, compared_seconds=2.0),
        thetas=Thetas((0.5, Physics().theta), (0.02,), (0.2,), behaviours=4, seconds=5.0),
    )


def measure(effort: Effort, say: Progress = lambda _: None) -> Tables:
    """Run everything.

    Returns
    -------
    dict of DataFrame
        ``curves``, ``ladder``, ``limits``: one spring (`stability_spring`); ``chains``, ``impacts``, ``inside``
        (`stability_scenes`); ``box``, ``corner``, ``explicit``: the morphology box (`stability_box`); ``factors``,
        ``safe``: safe wobbles, and ``thetas`` (`stability_safe`).
    """
    theta, box = Physics().theta, effort.box
    say("one spring")
    tables = {name: getattr(stability_spring, name)(theta) for name in ("curves", "ladder", "limits")}
    say("hanging chains, impacts, starts inside the floor")
    settings = [
        Physics(integrator=name, precision=precision, dt=dt, refinements=0)
        for name in RUN
        for precision in effort.precisions
        for dt in _steps(AUTHORS_STEP)
    ]
    tables["chains"] = stability_scenes.chains(settings)
    tables["impacts"] = stability_scenes.impacts(settings)
    tables["inside"] = stability_scenes.starts_inside(settings)
    tables["box"] = stability_box.box(box, _box_settings(effort), effort.box_trying, say)
    tables["corner"] = stability_box.corner(box, effort.box_trying)
    tables["explicit"] = stability_box.explicit_limits(box)
    shipped = [Physics(integrator=name) for name in RUN]
    tables["factors"] = stability_safe.factor_cells(
        shipped, effort.safe_steps, effort.factors, effort.safe_trying, DIMENSIONS, say
    )
    tables["safe"] = stability_safe.ranges(tables["factors"])
    tables["thetas"] = stability_safe.theta_counts(effort.thetas, say)
    return tables


def _box_settings(effort: Effort) -> list[Physics]:
    default = Physics().integrator
    return [
        Physics(integrator=name, precision=precision)
        for name in RUN
        for precision in (effort.box_precisions if name == default else effort.box_precisions[:1])
    ]


def write_tables(tables: Tables, folder: Path) -> None:
    """Write every table as ``NAME.parquet``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in tables.items():
        frame.to_parquet(folder / f"{name}.parquet", index=False)
