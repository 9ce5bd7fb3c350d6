"""The configuration restates the simulator's defaults, for it may not import them: here they must agree."""

import inspect
from dataclasses import MISSING, fields

import numpy as np
import pytest

from wobblesim.config import parse_config, schema
from wobblesim.learning.search import Search
from wobblesim.learning.wobble import Wobble
from wobblesim.physics.scene import Floor, Physics, Scene
from wobblesim.robot.gait import Gait
from wobblesim.robot.starfish import starfish
from wobblesim.study.plan import setup

ONLY_SETTINGS = {"epochs", "duration"}  # of a run and of a trial: not of how a search or a gait works


def settings_defaults(section):
    return {
        name: field.default
        for name, field in section.model_fields.items()
        if not field.is_required() and name not in ONLY_SETTINGS
    }


def library_defaults(kind):
    return {field.name: field.default for field in fields(kind) if field.default is not MISSING}


@pytest.mark.parametrize(
    ("section", "kind"),
    [
        (schema.PhysicsSettings, Physics),
        (schema.FloorSettings, Floor),
        (schema.TrialSettings, Gait),
        (schema.LearningSettings, Search),
        (schema.WobbleSettings, Wobble),
    ],
)
def test_settings_have_the_defaults_of_the_library(section, kind):
    assert settings_defaults(section) == library_defaults(kind)


def test_the_starfish_of_the_settings_has_the_defaults_of_the_library():
    library = {name: p.default for name, p in inspect.signature(starfish).parameters.items() if name != "stiffness"}
    settings = settings_defaults(schema.StarfishRobot)
    settings.pop("stiffness")
    assert settings == library


def test_a_sweep_that_says_nothing_is_the_library_as_it_comes():
    found = setup(parse_config("name: a").parameters)
    assert (found.scene, found.physics, found.gait, found.search) == (Scene(), Physics(), Gait(), Search())
    for name in ("position", "mass", "friction", "springs", "stiffness", "damping_ratio", "rest_length"):
        np.testing.assert_array_equal(getattr(found.body, name), getattr(starfish(), name), err_msg=name)
