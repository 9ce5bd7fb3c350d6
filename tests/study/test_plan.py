"""Settings become setups, wanted runs minus present ones become groups."""

import numpy as np
import pytest
from study.toy import study as toy_study
from study.toy import toy

from wobblesim.config import columns, expand, parse_config
from wobblesim.learning.run import Learner
from wobblesim.robot.starfish import starfish
from wobblesim.study.plan import Group, PlanError, group_size, groups, lane_steps, setup, steps, study
from wobblesim.study.schema import PARAMETERS


def test_a_starfish_of_the_configuration_is_the_starfish_of_the_library():
    built = setup(parse_config("name: a\nrobot: {kind: starfish, arms: 5, stiffness: {side: 2000}}").parameters).body
    same = starfish(arms=5, stiffness={"diagonal": 1e5, "side": 2e3, "width": 1.2e4, "center": 5e5, "tip": 5e5})
    for name in ("position", "mass", "friction", "springs", "stiffness", "rest_length", "muscle_spring", "center"):
        assert np.array_equal(getattr(built, name), getattr(same, name)), name
    assert built.body_length == same.body_length


CUSTOM = """
name: triangle
robot:
  kind: custom
  nodes: [{position: [0, 0]}, {position: [3, 0], mass: 2, fixed: true}, {position: [0, 4], velocity: [1, 2]}]
  springs:
    - {between: [0, 1], stiffness: 10}
    - {between: [1, 2], stiffness: 20}
    - {between: [2, 0], stiffness: 5, rest_length: 1}
  muscles: [{spring: 1, group: 0, sign: -1}]
scene: {gravity: [1, -2], floor: null}
trial: {period: 0.5, max_amplitude: 0.2, duration: 3}
learning: {epochs: 7, population: 4, parents: 2, direction: either}
wobble: {dimension: [mass, size], amplitude: 0.1, period: 5}
"""


def test_a_robot_given_node_by_node_keeps_every_number():
    body = setup(parse_config(CUSTOM).parameters).body
    assert body.position.tolist() == [[0, 0], [3, 0], [0, 4]]
    assert body.velocity.tolist() == [[0, 0], [0, 0], [1, 2]]
    assert body.mass.tolist() == [1, 2, 1]
    assert body.fixed.tolist() == [False, True, False]
    assert body.stiffness.tolist() == [10, 20, 5]
    assert body.rest_length.tolist() == [3, 5, 1]
    assert (body.muscle_spring.tolist(), body.muscle_group.tolist(), body.muscle_sign.tolist()) == ([1], [0], [-1])
    assert (body.n_groups, body.body_length, body.center.tolist()) == (1, 3, [0, 1, 2])


def test_scene_gait_and_learning_of_the_configuration_arrive():
    found = setup(parse_config(CUSTOM).parameters)
    assert (found.scene.gravity, found.scene.floor) == ((1, -2), None)
    assert (found.gait.period, found.gait.max_amplitude, found.duration) == (0.5, 0.2, 3)
    assert (found.search.population, found.search.parents, found.search.direction, found.epochs) == (4, 2, "either", 7)
    assert found.wobble is not None
    assert found.wobble.dimensions == ("mass", "size")


def test_an_integrator_refuses_its_step_before_anything_is_computed():
    too_long = parse_config("name: a\nphysics: {integrator: explicit, dt: 0.01}")
    with pytest.raises(PlanError, match=r"condition a: .*dt"):
        _ = study(too_long).setups


def test_the_step_is_judged_at_the_lightest_robot_of_the_wobble():
    adult = "name: a\nphysics: {integrator: explicit, dt: 0.0002}\ntrial: {duration: 1}\nlearning: {epochs: 30}\n"
    assert study(parse_config(adult)).setups
    wobbling = adult + "wobble: {dimension: mass, amplitude: 0.9, period: 25}"
    with pytest.raises(PlanError):
        _ = study(parse_config(wobbling)).setups


def test_each_setting_of_the_configuration_is_a_column_of_the_runs():
    assert set(columns(expand(toy_study())[0].parameters)) == set(PARAMETERS)


# --- groups --------------------------------------------------------------------------------------------------------


def runs(*conditions: str, seeds: range) -> list[tuple[str, int]]:
    return [(condition, seed) for condition in conditions for seed in seeds]


def test_no_run_is_lost_or_doubled_by_grouping():
    missing = runs("a", "b", seeds=range(7))[3:]
    found = [run for group in groups(missing, 3) for run in group.runs]
    assert sorted(found) == sorted(missing)


def test_all_conditions_run_their_first_seeds_before_any_runs_the_next():
    made = groups(runs("a", "b", seeds=range(5)), 3)
    assert [(group.condition, group.seeds) for group in made] == [
        ("a", (0, 1, 2)),
        ("b", (0, 1, 2)),
        ("a", (3, 4)),
        ("b", (3, 4)),
    ]


def test_groups_begun_earlier_come_first_and_as_they_were():
    begun = Group("b", (1, 4))
    made = groups(runs("a", "b", seeds=range(5)), 8, [begun])
    assert made[0] == begun
    assert made[1:] == [Group("a", (0, 1, 2, 3, 4)), Group("b", (0, 2, 3))]


@pytest.mark.parametrize("tried", [15, 20])
@pytest.mark.parametrize("threads", [1, 2, 6])
def test_a_full_group_fills_as_many_blocks_on_each_thread(tried, threads):
    assert tried * group_size(threads) % (16 * threads) == 0


@pytest.mark.parametrize("condition", [0, 1])
def test_the_announced_work_is_what_the_learner_simulates(condition):
    found = setup(expand(toy_study())[condition].parameters)
    learner, lanes = Learner(found, [0], simulate=toy), []
    while not learner.done:
        lanes.append(int((~learner.advance().reused).sum()))
    # A wobble meets two equal factors in a row only by chance: at most.
    assert sum(lanes) * steps(found) <= lane_steps(found) <= (sum(lanes) + 5) * steps(found)
    assert lane_steps(found, since=8) == sum(lanes[8:]) * steps(found)
