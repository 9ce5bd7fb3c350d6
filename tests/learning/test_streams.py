"""Random numbers of a run: a stream of its own for each seed, whatever else runs, and wherever it goes on. DT-9."""

import numpy as np
import pytest

import wobblesim as ws
from wobblesim.learning.run import Learner, Setup
from wobblesim.learning.search import Search, generator, initial_population
from wobblesim.physics.simulate import Trials

SEEDS = range(1000)
GROUPS = 2


def landscape(body, behaviours, **_) -> Trials:
    """A task that needs no robot: the performance is the first amplitude."""
    n = len(behaviours)
    return Trials(
        displacement=behaviours[:, 0],
        status=np.full(n, "ok"),
        dt=np.full(n, 0.01),
        bound=np.full(n, ""),
        limited=np.zeros(n, np.int64),
        diverged_at=np.full(n, np.nan),
        inverted=np.zeros(n, np.int64),
        positions=None,
    )


def setup(epochs: int = 4) -> Setup:
    body = ws.Body.from_arrays(
        [(0, 0), (30, 0), (15, 25)], [(0, 1), (1, 2), (2, 0)], muscles=[(0, 0, 1.0), (2, 1, -1.0)]
    )
    return Setup(body, ws.Scene(), ws.Physics(), ws.Gait(), 1.0, Search(), wobble=None, epochs=epochs)


def behaviours(learner: Learner) -> np.ndarray:
    """All behaviours that the learner still tries, (epochs, seeds, slots, 2 groups)."""
    tried = []
    while not learner.done:
        tried.append(learner.advance().behaviours)
    return np.array(tried)


@pytest.fixture(scope="module")
def tried() -> np.ndarray:
    return behaviours(Learner(setup(), SEEDS, simulate=landscape))


def test_no_two_of_1000_seeds_share_a_number():
    drawn = np.stack([generator(seed).random(100) for seed in SEEDS])
    assert len(np.unique(drawn)) == drawn.size  # 1e5 of 2^53 numbers: by chance two are equal once in 2e6 times


def test_streams_of_neighbouring_seeds_are_unrelated():
    drawn = np.stack([generator(seed).random(1000) for seed in SEEDS])
    related = np.corrcoef(drawn)[np.triu_indices(len(SEEDS), 1)]
    assert np.abs(related).max() < 0.18  # measured 0.149; 5e5 pairs of 1000: 5 sigma are 0.158
    assert np.std(related) == pytest.approx(1000**-0.5, rel=0.01)  # measured 0.0316


def test_no_two_runs_try_the_same(tried):
    for epoch in tried:
        assert len(np.unique(epoch.reshape(len(SEEDS), -1), axis=0)) == len(SEEDS)


def test_a_run_is_that_of_its_seed_in_any_order(tried):
    order = np.random.default_rng(0).permutation(len(SEEDS))
    shuffled = behaviours(Learner(setup(), [SEEDS[i] for i in order], simulate=landscape))
    np.testing.assert_array_equal(shuffled, tried[:, order])


@pytest.mark.parametrize("seed", [0, 1, 999])
def test_a_run_is_that_of_its_seed_alone(tried, seed):
    np.testing.assert_array_equal(behaviours(Learner(setup(), [seed], simulate=landscape))[:, 0], tried[:, seed])


@pytest.mark.parametrize("stop", [1, 3])
def test_all_runs_go_on_where_they_stopped(tried, stop):
    first = Learner(setup(), SEEDS, simulate=landscape)
    for _ in range(stop):
        first.advance()
    second = Learner.restored(setup(), SEEDS, first.snapshot(), simulate=landscape)
    np.testing.assert_array_equal(behaviours(second), tried[stop:])


def test_streams_take_nothing_from_the_random_numbers_of_the_process():
    population = initial_population(generator(5), Search(), GROUPS)
    state = np.random.get_state()  # noqa: NPY002 - the state of the process is what must not matter
    np.random.seed(1)  # noqa: NPY002
    np.testing.assert_array_equal(initial_population(generator(5), Search(), GROUPS), population)
    np.random.set_state(state)  # noqa: NPY002
