"""Whatever is written, the answer is a configuration or a line that says what is wrong with it."""

from __future__ import annotations

import json
from typing import Any

import pytest
import yaml
from config.from_schema import configurations
from hypothesis import HealthCheck, given, settings

from wobblesim.config import ConfigError, dump, expand, parse_config

BETWEEN_KEYS = (
    "is shorter than one step",
    "steps; at most",
    "motor groups cannot share",
    "cannot join a base",
    "leaves nothing new to try",
    "and a factor must be above 0",
    "after the end",
    "is listed twice",
    "can only be built above",
    "lies inside",
    "is the same as",
    "exists twice",
    "differs from",
    "cannot be the id",
    "cannot name a file",
    "gives 0 seeds",
    "unknown key for a robot of kind",
    "is missing",
    "there is no node",
    "there is no spring",
    "to itself",
    "at the same place",
    "is a muscle already",
    "has no muscle although",
    "lets the muscle shrink",
    "starts below the floor",
    "is a single value",
    "are allowed, so",
    "is empty; write the smaller seed first",
    "a muscle of sign 0",
    "in it",
    "is given twice",
)
"""Rules that the schema cannot say."""


def answer_to(text: str) -> list[str]:
    """The errors of a configuration; of one without, what is read back from its dump must be equal."""
    try:
        config = parse_config(text, source="drawn.yaml")
    except ConfigError as error:
        return error.report().splitlines()
    assert len(expand(config)) == config.count_conditions()
    assert parse_config(dump(config)) == config
    return []


def check_valid(data: dict[str, Any]) -> None:
    faults = answer_to(json.dumps(data, ensure_ascii=False))
    assert [fault for fault in faults if not any(words in fault for words in BETWEEN_KEYS)] == []


def check_any(data: dict[str, Any]) -> None:
    for text in (json.dumps(data, ensure_ascii=False), yaml.safe_dump(data, allow_unicode=True, sort_keys=False)):
        for fault in answer_to(text):
            assert fault.isprintable()
            assert fault.startswith("drawn.yaml:")


LAX = {"deadline": None, "suppress_health_check": list(HealthCheck)}


@settings(max_examples=150, **LAX)
@given(configurations())
def test_bi_9_what_the_schema_allows_is_valid_or_breaks_a_rule_between_keys(data: dict[str, Any]) -> None:
    check_valid(data)


@settings(max_examples=300, **LAX)
@given(configurations(rubbish=True))
def test_bi_9_any_mixture_of_sense_and_nonsense_is_answered(data: dict[str, Any]) -> None:
    check_any(data)


@pytest.mark.nightly
@settings(max_examples=20_000, derandomize=False, **LAX)
@given(configurations(rubbish=True))
def test_bi_9_twenty_thousand_mixtures_are_answered(data: dict[str, Any]) -> None:
    check_any(data)


@pytest.mark.nightly
@settings(max_examples=5_000, derandomize=False, **LAX)
@given(configurations())
def test_bi_9_the_schema_agrees_with_five_thousand_configurations(data: dict[str, Any]) -> None:
    check_valid(data)
