"""wobblesim: does oscillating a robot's morphology while it learns make it learn better?"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wobblesim.analysis.comparison import compare as compare
    from wobblesim.analysis.figures.registry import Choice as Choice
    from wobblesim.analysis.figures.registry import draw as draw
    from wobblesim.analysis.tables import load as load
    from wobblesim.config.load import load_config as load_config
    from wobblesim.physics.registry import INTEGRATORS as INTEGRATORS
    from wobblesim.physics.scene import Floor as Floor
    from wobblesim.physics.scene import Physics as Physics
    from wobblesim.physics.scene import Scene as Scene
    from wobblesim.physics.simulate import Trials as Trials
    from wobblesim.physics.simulate import simulate as simulate
    from wobblesim.robot.body import Body as Body
    from wobblesim.robot.gait import Gait as Gait
    from wobblesim.robot.morphology import Morphology as Morphology
    from wobblesim.robot.starfish import starfish as starfish
    from wobblesim.study.execute import sweep as sweep
    from wobblesim.viewing.replay import replay as replay
    from wobblesim.viewing.report import report as report

__version__ = "0.1.0"

# Imported when first used, so that `wobblesim --help` need not wait for Numba.
_HOME = {
    "Body": "robot.body",
    "Choice": "analysis.figures.registry",
    "Floor": "physics.scene",
    "Gait": "robot.gait",
    "INTEGRATORS": "physics.registry",
    "Morphology": "robot.morphology",
    "Physics": "physics.scene",
    "Scene": "physics.scene",
    "Trials": "physics.simulate",
    "compare": "analysis.comparison",
    "draw": "analysis.figures.registry",
    "load": "analysis.tables",
    "load_config": "config.load",
    "replay": "viewing.replay",
    "report": "viewing.report",
    "simulate": "physics.simulate",
    "starfish": "robot.starfish",
    "sweep": "study.execute",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
