"""Configuration: one YAML file becomes one frozen, checked object."""

from wobblesim.config.errors import ConfigError
from wobblesim.config.grid import Condition, columns, expand
from wobblesim.config.json_schema import json_schema
from wobblesim.config.load import condition_error, dump, load_config, parse_config, remarks
from wobblesim.config.schema import (
    CustomRobot,
    FloorSettings,
    LearningSettings,
    Parameters,
    PhysicsSettings,
    SceneSettings,
    StarfishRobot,
    SweepConfig,
    TrialSettings,
    WobbleSettings,
)

__all__ = [
    "Condition",
    "ConfigError",
    "CustomRobot",
    "FloorSettings",
    "LearningSettings",
    "Parameters",
    "PhysicsSettings",
    "SceneSettings",
    "StarfishRobot",
    "SweepConfig",
    "TrialSettings",
    "WobbleSettings",
    "columns",
    "condition_error",
    "dump",
    "expand",
    "json_schema",
    "load_config",
    "parse_config",
    "remarks",
]
