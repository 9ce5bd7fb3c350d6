"""The promises of the learning runs with the real simulation, on a small starfish."""

from dataclasses import replace

import numpy as np
import pytest

from wobblesim.learning.run import Epoch, Learner, Setup
from wobblesim.learning.search import Search
from wobblesim.learning.wobble import Wobble
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import simulate
from wobblesim.robot.gait import Gait
from wobblesim.robot.starfish import starfish

WOBBLE = Wobble(("mass", "size"), amplitude=0.3, period=8, end=6, decay_start=6, upper_bound=1.0)
SETUP = Setup(
    body=starfish(arms=3, sections=2),
    scene=Scene(),
    physics=Physics(integrator="midpoint", dt=0.01, precision="float32"),
    gait=Gait(),
    duration=1.0,
    search=Search(population=8, parents=3),
    wobble=WOBBLE,
    epochs=9,
)
SEEDS = (0, 1, 2)


def epochs_of(learner: Learner) -> list[Epoch]:
    epochs = []
    while not learner.done:
        epochs.append(learner.advance())
    return epochs


def bits(epochs: list[Epoch], seed=slice(None), without: tuple[str, ...] = ()) -> list[dict[str, object]]:
    return [
        {n: v[seed].tobytes() if isinstance(v, np.ndarray) else v for n, v in vars(epoch).items() if n not in without}
        for epoch in epochs
    ]


@pytest.fixture(scope="module")
def learned() -> list[Epoch]:
    return epochs_of(Learner(SETUP, SEEDS))


def test_the_starfish_moves_and_the_morphology_matters(learned):
    performance = np.stack([epoch.performance for epoch in learned])
    assert np.isfinite(performance).all()
    assert len(np.unique(performance[0])) == 24
    assert 0.01 < performance.std() < 0.1  # measured 0.028 body lengths
    # The kept behaviours of epoch 5 (the adult in epoch 4, a lighter and smaller robot in epoch 5) score otherwise.
    kept = np.take_along_axis(learned[4].performance, learned[5].parent[:, :3], axis=1)
    assert (kept != learned[5].performance[:, :3]).all()


def test_reused_behaviours_have_the_bits_of_trying_again(learned):
    assert [bool(epoch.reused.any()) for epoch in learned] == [False, True, True, True, True, False, False, True, True]
    again = epochs_of(Learner(SETUP, SEEDS, reuse=False))
    assert bits(again, without=("reused",)) == bits(learned, without=("reused",))


def test_a_run_alone_on_one_thread_has_the_bits_of_the_lockstep(learned):
    for place, seed in enumerate(SEEDS):
        alone = epochs_of(Learner(SETUP, [seed], threads=1))
        assert bits(alone) == bits(learned, slice(place, place + 1))


@pytest.mark.parametrize("stop", [0, 5, 9])
def test_a_restored_run_goes_on_with_the_same_bits(learned, stop):
    learner = Learner(SETUP, SEEDS)
    for _ in range(stop):
        learner.advance()
    assert bits(epochs_of(Learner.restored(SETUP, SEEDS, learner.snapshot()))) == bits(learned[stop:])


def test_the_best_of_an_epoch_scores_the_same_when_tried_alone(learned):
    last = learned[-1]
    for seed, slot in enumerate(last.best):
        behaviour = last.behaviours[seed, slot][None]
        trials = simulate(
            SETUP.body,
            behaviour,
            morphology=last.morphology,
            scene=SETUP.scene,
            physics=SETUP.physics,
            gait=SETUP.gait,
            duration=SETUP.duration,
        )
        assert trials.displacement.tobytes() == last.performance[seed, slot].tobytes()


def test_a_robot_beyond_its_speed_bound_scores_nan():
    # Free fall reaches 30 u/s after 0.3 s and 4.5 u, long before the floor; the kernels are those of the runs above.
    high = replace(SETUP.body, position=np.add(SETUP.body.position, [0.0, 100.0]), build=None)
    falling = replace(SETUP, body=high, physics=replace(SETUP.physics, max_speed=30.0), epochs=2)
    for epoch in epochs_of(Learner(falling, SEEDS)):
        assert (epoch.status == "diverged").all()
        assert np.isnan(epoch.performance).all()
        assert (epoch.bound == "speed").all()
        assert (epoch.dt == SETUP.physics.dt / 8).all()  # three refinements, in vain
        assert (epoch.diverged_at <= 0.3 + 33 * SETUP.physics.dt / 8).all()  # looked for every 32 steps
        assert epoch.best.tolist() == [0, 0, 0]
