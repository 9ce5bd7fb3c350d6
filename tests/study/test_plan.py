"""Settings become setups, wanted runs minus present ones become groups."""

import itertools
import json
import re
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from study.toy import study as toy_study
from study.toy import toy

from wobblesim.config import ConfigError, columns, expand, parse_config
from wobblesim.learning.run import Learner
from wobblesim.robot.starfish import starfish
from wobblesim.study.plan import (
    Group,
    Kind,
    PlanError,
    Study,
    group_size,
    lane_steps,
    makespan,
    plan,
    setup,
    shares,
    span,
    steps,
    study,
)
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
    with pytest.raises(ConfigError, match=r"<text>:2:37: physics.dt: explicit is unstable at dt 0.01 s: its limit"):
        _ = study(too_long).setups


def test_the_step_is_judged_at_the_lightest_robot_of_the_wobble():
    adult = "name: a\nphysics: {integrator: explicit, dt: 0.0002}\ntrial: {duration: 1}\nlearning: {epochs: 30}\n"
    assert study(parse_config(adult)).setups
    wobbling = adult + "wobble: {dimension: mass, amplitude: 0.9, period: 25}"
    light = parse_config(wobbling)
    with pytest.raises(ConfigError, match="explicit is unstable"):
        _ = study(light).setups


def test_the_step_is_judged_by_the_robots_that_epochs_meet():
    # A period of 4 epochs meets the trough of the sine, one of 3 only sin(240°) = -0.866: the lightest robots have 0.1
    # and 0.2206 of the mass, and the limit on the step goes with the root of it.
    limits = []
    for period in (4, 3):
        text = (
            "name: a\ntrial: {duration: 1}\nlearning: {epochs: 30}\nphysics: {integrator: explicit, dt: 0.0003}\n"
            f"wobble: {{dimension: mass, amplitude: 0.9, period: {period}}}"
        )
        with pytest.raises(PlanError) as refused:
            _ = study(parse_config(text)).setups
        found = re.search(r"its limit for this body is ([0-9.e-]+) s", str(refused.value))
        assert found
        limits.append(float(found[1]))
        assert study(parse_config(text, [f"physics.dt={0.99 * limits[-1]}"])).setups
    assert abs(limits[0] / limits[1] / (0.1 / 0.2206) ** 0.5 - 1) < 0.01  # measured 0.003


def test_of_many_conditions_the_one_with_the_unstable_step_is_named():
    grid = (
        "name: a\nphysics: {integrator: explicit, dt: 0.0002}\nwobble: {dimension: mass, amplitude: 0.1, period: 25}\n"
    )
    assert study(parse_config(grid + "sweep: {wobble.amplitude: [0.1, 0.2, 0.3]}")).setups
    with pytest.raises(PlanError, match=r"^condition amplitude-0\.9: explicit is unstable"):
        _ = study(parse_config(grid + "sweep: {wobble.amplitude: [0.1, 0.9, 0.3]}")).setups


def test_what_conditions_have_in_common_is_built_once():
    grid = "name: a\nwobble: {dimension: mass, amplitude: 0.1, period: 25}\nsweep: {wobble.period: [5, 6, 7]}"
    setups = list(study(parse_config(grid)).setups.values())
    for name in ("body", "scene", "physics", "gait", "search"):
        assert len({id(getattr(made, name)) for made in setups}) == 1, name
    assert [made.wobble.period for made in setups] == [5, 6, 7]


@pytest.mark.parametrize("text", ["name: a\nwobble: {dimension: [mass, size], amplitude: 0.1, period: 5}", CUSTOM])
def test_the_settings_that_are_stored_are_those_of_the_configuration(text):
    laid_out = study(parse_config(text))
    for name, parameters in laid_out.conditions.items():
        whole = parameters.model_dump(mode="json")
        assert laid_out.written[name] == whole == json.loads(json.dumps(whole))
        assert type(parameters).model_validate(laid_out.written[name]) == parameters


def test_each_setting_of_the_configuration_is_a_column_of_the_runs():
    assert set(columns(expand(toy_study())[0].parameters)) == set(PARAMETERS)


# --- groups --------------------------------------------------------------------------------------------------------


def grid(conditions: int, seeds: str = "0..6", **settings) -> Study:
    amplitudes = ", ".join(str(0.1 + place / 1000) for place in range(conditions))
    return study(
        parse_config(
            f"name: a\nseeds: {seeds}\nwobble: {{dimension: mass, amplitude: 0.1, period: 5}}\n"
            f"sweep: {{wobble.amplitude: [{amplitudes}]}}",
            [f"{key}={value}" for key, value in settings.items()],
        )
    )


def runs(groups):
    return [run for group in groups for run in group.runs]


@pytest.mark.parametrize(("workers", "threads"), [(1, 1), (2, 1), (3, 4), (64, 1)])
def test_no_run_is_lost_or_doubled_by_grouping(workers, threads):
    wanted = grid(3)
    first, second, third = wanted.conditions
    begun = Group(second, (1, 4))
    present = {(first, seed) for seed in range(5)} | {(second, 6)}
    todo = plan(wanted, present, [begun], workers, threads)
    every = {(condition, seed) for condition in (first, second, third) for seed in range(7)}
    assert sorted(runs(todo)) == sorted(every - present)
    assert next(iter(todo)) == begun
    assert len(todo) == len(list(todo))
    assert todo.work(wanted) == sum(lane_steps(wanted.setups[name]) for name, _ in runs(todo))


def test_all_conditions_run_their_first_seeds_before_any_runs_the_next():
    wanted = grid(2, "0..39")
    groups = list(plan(wanted, (), (), workers=1, threads=1))
    assert len(groups) > 2
    assert [group.condition for group in groups] == [*wanted.conditions] * (len(groups) // 2)
    assert [group.seeds for group in groups[::2]] == [group.seeds for group in groups[1::2]]
    assert [seed for group in groups[::2] for seed in group.seeds] == list(range(40))


def test_seeds_that_are_there_leave_a_gap_and_nothing_else():
    wanted = grid(2, "3,5,9,2")
    one, other = wanted.conditions
    groups = list(plan(wanted, {(one, 5), (other, 3), (other, 77), ("gone", 9)}, (), workers=1, threads=1))
    assert groups == [Group(one, (3, 9, 2)), Group(other, (5, 9, 2))]


@given(st.integers(1, 500), st.integers(1, 60))
def test_shares_are_few_and_equal(count, size):
    parts = shares(count, size)
    assert sum(parts) == count
    assert max(parts) <= size
    assert max(parts) - min(parts) <= 1
    assert len(parts) == -(-count // size)


@pytest.mark.parametrize("tried", [15, 20])
@pytest.mark.parametrize("threads", [1, 2, 6])
def test_groups_of_many_seeds_fill_the_lanes_of_each_thread(tried, threads):
    # blocks of 16 lanes, dealt to the threads in rounds: how much of what runs is in use
    kind = Kind.of(next(iter(grid(1).setups.values())))
    size = group_size({(kind, 10_000): 1}, 1, threads)
    blocks = -(-size * tried // 16)
    rounds = -(-blocks // threads)
    assert size * tried == rounds * threads * 16


@pytest.mark.parametrize("workers", [2, 4, 7])
def test_no_worker_idles_while_another_has_seeds_to_spare(workers):
    kind = Kind.of(next(iter(grid(1).setups.values())))
    for count in (workers, 2 * workers, 5 * workers):
        size = group_size({(kind, count): 1}, workers, 1)
        assert max(Counter(shares(count, size)).elements()) * workers <= count + workers - 1


@given(st.lists(st.integers(1, 30), min_size=1, max_size=7), st.integers(1, 3))
def test_the_span_is_within_grahams_bound_of_the_best(times, workers):
    # R. L. Graham, Bounds on multiprocessing timing anomalies, SIAM J. Appl. Math. 17 (1969): the longest first takes
    # at most 4/3 - 1/(3m) of the shortest time there is on m machines.
    best = min(
        max(sum(time for time, worker in zip(times, dealt, strict=True) if worker == mine) for mine in range(workers))
        for dealt in itertools.product(range(workers), repeat=len(times))
    )
    found = span(Counter(map(float, times)), workers)
    assert best <= found <= best * (4 / 3 - 1 / (3 * workers)) + 1e-9


def test_the_span_of_many_groups_is_that_of_dealing_them_out(monkeypatch):
    groups = Counter(dict.fromkeys((3.0, 5.0, 11.0, 2.5), 40))
    quick = span(groups, 3)
    monkeypatch.setattr("wobblesim.study.plan.MANY_GROUPS", 10**6)
    assert abs(quick - span(groups, 3)) < max(groups) / 2  # measured 4.7 of 5.5


def test_the_size_chosen_is_as_good_as_any():
    short, long = (Kind.of(next(iter(grid(1, **{"trial.duration": time}).setups.values()))) for time in (5, 60))
    mixed = {(short, 30): 4, (long, 7): 2}
    for workers, threads in ((1, 1), (3, 1), (2, 2), (16, 1)):
        size = group_size(mixed, workers, threads)
        best = min(makespan(mixed, other, workers, threads) for other in range(1, 31))
        assert makespan(mixed, size, workers, threads) <= 1.01 * best


# --- shards --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 3, 8, 50])
def test_shards_share_out_all_runs_and_the_work(count):
    whole = grid(3, "0..9", sweep="{wobble.period: [5, 6, 7], learning.epochs: [40, 400]}")
    parts = [whole.shard(number, count) for number in range(1, count + 1)]
    dealt = [(condition, seed) for part in parts for condition in part.conditions for seed in part.seeds_of(condition)]
    assert sorted(dealt) == sorted((condition, seed) for condition in whole.conditions for seed in whole.seeds)
    assert sum(part.n_runs for part in parts) == whole.n_runs == 60
    work = [sum(len(seeds) * lane_steps(whole.setups[name]) for name, seeds in part.part.items()) for part in parts]
    longest = max(map(lane_steps, whole.setups.values()))
    assert max(work) - min(work) <= 2 * longest  # each cut is off by less than a run
    for part in parts:
        assert all(part.asks_for(run) == (run in runs(plan(part, (), (), 1, 1))) for run in dealt)


def test_a_shard_is_the_same_whatever_is_there():
    whole = grid(3, "0..9")
    mine = whole.shard(2, 3)
    present = {(condition, seed) for condition in mine.part for seed in mine.part[condition][::2]}
    assert {*runs(plan(mine, present, (), 1, 1))} == {*runs(plan(mine, (), (), 1, 1))} - present


# --- work ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("condition", [0, 1])
def test_the_announced_work_is_what_the_learner_simulates(condition):
    found = setup(expand(toy_study())[condition].parameters)
    learner, lanes = Learner(found, [0], simulate=toy), []
    while not learner.done:
        lanes.append(int((~learner.advance().reused).sum()))
    # A wobble meets two equal factors in a row only by chance: at most.
    assert sum(lanes) * steps(found) <= lane_steps(found) <= (sum(lanes) + 5) * steps(found)
    assert lane_steps(found, since=8) == sum(lanes[8:]) * steps(found)
