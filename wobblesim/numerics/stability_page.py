"""The page `docs/stability.md`: a template filled with what was measured; no figure in it is typed by hand."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template

import pandas as pd

from wobblesim.analysis.figures import stability_maps
from wobblesim.numerics.stability import AUTHORS_STEP, Effort, Tables, full
from wobblesim.numerics.stability_box import GAINS, TOLERANCE, Trying
from wobblesim.numerics.stability_energy import HEIGHT, TILT
from wobblesim.numerics.stability_scenes import PHASES
from wobblesim.numerics.stability_spring import MOST, STRAIN
from wobblesim.numerics.stability_text import Text, texts
from wobblesim.numerics.throughput import conditions
from wobblesim.physics.scene import Floor, Physics

TEMPLATE = "stability_page.md"


def draw(tables: Tables, folder: Path, prefix: str = "") -> dict[str, Path]:
    """Write all pictures as PNG and SVG; returns the PNG of each."""
    figures = {
        "spring": stability_maps.spring_figure(tables["curves"], tables["ladder"], tables["limits"]),
        **dict(stability_maps.box_figures(tables["box"])),
        "explicit": stability_maps.explicit_figure(tables["explicit"]),
        "factors": stability_maps.factor_figure(tables["factors"]),
    }
    for name, figure in figures.items():
        stability_maps.save(figure, folder / f"{prefix}{name}")
    return {name: folder / f"{prefix}{name}.png" for name in figures}


def write(tables: Tables, effort: Effort, page: Path, drawn: Mapping[str, Path] | None = None) -> None:
    """Write the page, and its pictures into the folder ``_static`` beside it.

    Pictures that `draw` has written elsewhere already are copied from there: drawing takes as long as a short form.
    """
    folder, prefix = page.parent / "_static", "stability-"
    pictures = _copy(drawn, folder, prefix) if drawn else draw(tables, folder, prefix)
    template = Template(resources.files("wobblesim.numerics").joinpath(TEMPLATE).read_text(encoding="utf-8"))
    words = _settings() | _effort(effort) | _pictures(pictures) | _measured(tables)
    page.write_text(template.substitute(words), encoding="utf-8")


def _copy(drawn: Mapping[str, Path], folder: Path, prefix: str) -> dict[str, Path]:
    folder.mkdir(parents=True, exist_ok=True)
    for name, path in drawn.items():
        for suffix in (".png", ".svg"):
            shutil.copyfile(path.with_suffix(suffix), folder / f"{prefix}{name}{suffix}")
    return {name: folder / f"{prefix}{name}.png" for name in drawn}


def markdown(text: Text) -> str:
    """A table in Markdown, with its title."""
    lines = [text.columns, ["---"] * len(text.columns), *text.rows]
    return "\n".join([f"*{text.title}*\n", *("| " + " | ".join(line) + " |" for line in lines)])


def _settings() -> dict[str, str]:
    physics, floor = Physics(), Floor()
    return {
        "integrator": physics.integrator, "dt": f"{physics.dt:g}", "precision": physics.precision,
        "theta": f"{physics.theta:g}", "refinements": f"{physics.refinements}",
        "most": f"{MOST:,.0f}", "strain": f"{STRAIN:g}",
        "floor_stiffness": f"{floor.stiffness:,.0f}", "law": f"{math.sqrt(floor.restitution * floor.stiffness):g}",
        "authors_step": f"{AUTHORS_STEP:g}", "phases": f"{PHASES}", "tilt": f"{TILT:g}", "height": f"{HEIGHT:g}",
        "gains": f"{100 * GAINS:g} %", "tolerance": f"{TOLERANCE:g}",
        "conditions": ", ".join(f"{name} {value}" for name, value in conditions().items()),
    }  # fmt: skip


def _effort(effort: Effort) -> dict[str, str]:
    box = effort.box
    return {
        "effort": "" if effort == full() else "**This is the short form, a smoke test.**",
        "box_mass": _ends(box.mass), "box_stiffness": _ends(box.stiffness), "box_size": _ends(box.size),
        "box_cells": f"{len(box.morphologies)}", **_trying("box", effort.box_trying),
        "factors": _ends(effort.factors), **_trying("safe", effort.safe_trying),
        "theta_seconds": f"{effort.thetas.seconds:g}",
    }  # fmt: skip


def _trying(prefix: str, trying: Trying) -> dict[str, str]:
    return {f"{prefix}_{name}": f"{value:g}" for name, value in vars(trying).items()}


def _ends(values: Sequence[float]) -> str:
    return f"{min(values):g} to {max(values):g}" if len(values) > 1 else f"{values[0]:g}"


def _pictures(pictures: Mapping[str, Path]) -> dict[str, str]:
    names = {name: path.name for name, path in pictures.items()}
    boxes = [f"![Classes over the box: {name[4:]}](_static/{path})" for name, path in names.items() if "box" in name]
    return {f"{name}_picture": path for name, path in names.items()} | {"box_pictures": "\n\n".join(boxes)}


def _measured(tables: Tables) -> dict[str, str]:
    limit = tables["explicit"]["limit"]
    return {text.name: markdown(text) for text in texts(tables)} | {
        "why": why(tables["box"]),
        "explicit_least": f"{limit.min():.2g}",
        "explicit_most": f"{limit.max():.2g}",
    }


def why(box: pd.DataFrame) -> str:
    """Which cells the default diverges in at its step, and whether in double precision too."""
    default, key = Physics(), ["mass", "stiffness", "size"]
    mine = box[(box["integrator"] == default.integrator) & (box["dt"] == default.dt)]
    single, double = (mine[mine["precision"] == name].set_index(key) for name in ("float32", "float64"))
    bad = single["diverged"] > 0
    at = f"At dt {default.dt:g} trials of `{default.integrator}`"
    if not bad.any():
        return f"{at} diverge in no cell."
    mass, stiffness, _ = zip(*single.index[bad], strict=True)
    words = [
        f"{at} in float32 diverge in {bad.sum()} cells, all with a mass of × {max(mass):.2g} or less and a stiffness",
        f"of × {min(stiffness):.2g} or more: stiff muscles between light nodes.",
    ]
    if len(double):
        also = double["diverged"] > 0
        words.append(f"In float64 {int((also & bad).sum())} of them diverge too, and {also.sum()} cells in all.")
    return " ".join(words)
