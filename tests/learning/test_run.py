"""The learning runs, on landscapes that stand in for `simulate`: `wobblesim/learning/run.py`.

The same promises with the real robot are in `test_run_robot.py`.
"""

import dataclasses
import itertools
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from wobblesim.learning import run
from wobblesim.learning.run import Epoch, Learner, Setup
from wobblesim.learning.search import Search, generator, initial_population, ranking
from wobblesim.learning.wobble import Wobble
from wobblesim.physics.scene import Physics, Scene
from wobblesim.physics.simulate import Trials
from wobblesim.robot.body import Body
from wobblesim.robot.gait import Gait
from wobblesim.robot.morphology import Morphology

GROUPS = 2
BODY = Body.from_arrays(
    [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]],
    [[0, 1], [1, 2]],
    stiffness=100.0,
    muscles=[(0, 0, 1), (1, 1, 1)],
)
MASS = Wobble("mass", amplitude=0.5, period=8, end=20)
PAUSED = Wobble("mass", amplitude=0.5, period=8, end=20, upper_bound=1.0)


def setup(wobble: Wobble | None = None, epochs: int = 30, **search: Any) -> Setup:
    return Setup(BODY, Scene(), Physics(), Gait(), duration=2.0, search=Search(**search), wobble=wobble, epochs=epochs)


def trials(
    displacement: Any,
    status: Any = "ok",
    dt: Any = 0.01,
    bound: Any = "",
    limited: Any = 0,
    diverged_at: Any = math.nan,
) -> Trials:
    """Outcomes made up, the same for all trials where a scalar is given."""
    given = (status, dt, bound, limited, diverged_at, 0)
    each = (np.broadcast_to(value, np.shape(displacement)) for value in given)
    return Trials(np.asarray(displacement, dtype=float), *each, positions=None)


@dataclass
class Landscape:
    """Stands in for `simulate`: the top lies at 0.3 times the mass factor in all coordinates, and is worth 1.

    Sums run column by column, so that a behaviour's bits do not depend on the batch. Where `ice` of the behaviour's
    first coordinate holds, the trial diverges.
    """

    ice: tuple[float, float] = (2.0, 2.0)
    lanes: list[int] = field(default_factory=list)

    def __call__(self, body, behaviours, *, morphology, scene, physics, gait, duration, threads):
        assert (body, duration, behaviours.shape[1]) == (BODY, 2.0, 2 * GROUPS)
        self.lanes.append(len(behaviours))
        height = np.ones(len(behaviours))
        for column in behaviours.T:
            height = height - (column - 0.3 * morphology.mass) ** 2
        diverged = (self.ice[0] <= behaviours[:, 0]) & (behaviours[:, 0] < self.ice[1])
        return trials(
            np.where(diverged, math.nan, height),
            status=np.where(diverged, "diverged", np.where(height > 0.5, "limited", "ok")),
            limited=np.where(height > 0.5, 3, 0),
            diverged_at=np.where(diverged, behaviours[:, 1], math.nan),
        )


def epochs_of(learner: Learner) -> list[Epoch]:
    epochs = []
    while not learner.done:
        epochs.append(learner.advance())
    return epochs


def learn(chosen: Setup, seeds=(0, 1, 2), *, reuse: bool = True, landscape: Landscape | None = None) -> list[Epoch]:
    return epochs_of(Learner(chosen, seeds, reuse=reuse, simulate=landscape or Landscape()))


def bits(epoch: Epoch, seed=slice(None), without: tuple[str, ...] = ()) -> dict[str, object]:
    """Everything in an epoch, of some of its seeds, as bytes."""
    values = {name: value for name, value in vars(epoch).items() if name not in without}
    return {name: v[seed].tobytes() if isinstance(v, np.ndarray) else v for name, v in values.items()}


def all_bits(epochs: list[Epoch], seed=slice(None), without: tuple[str, ...] = ()) -> list[dict[str, object]]:
    return [bits(epoch, seed, without) for epoch in epochs]


# --- what an epoch is -----------------------------------------------------------------------------------------------


def test_an_epoch_has_the_shapes_it_states():
    for epoch in learn(setup(MASS, epochs=3), seeds=[5, 6]):
        assert epoch.behaviours.shape == (2, 20, 4)
        for name in ("performance", "status", "dt", "bound", "limited", "diverged_at", "reused", "parent"):
            assert getattr(epoch, name).shape == (2, 20), name
        for name in ("best", "path", "path_before", "step_distance"):
            assert getattr(epoch, name).shape == (2,), name


def test_epoch_0_tries_the_initial_population_of_each_seed_in_every_condition():
    for chosen in (setup(), setup(MASS), setup(PAUSED, direction="either"), setup(parents=2)):
        first = Learner(chosen, [3, 1], simulate=Landscape()).advance()
        for seed, behaviours in zip((3, 1), first.behaviours, strict=True):
            assert behaviours.tobytes() == initial_population(generator(seed), Search(), GROUPS).tobytes()
        assert (first.parent == -1).all()
        assert not first.reused.any()


def test_each_epoch_keeps_the_best_of_the_last_and_perturbs_them():
    epochs = learn(setup(MASS))
    for last, epoch in itertools.pairwise(epochs):
        for s in range(3):
            kept = ranking(last.performance[s])[:5]
            assert epoch.parent[s].tolist() == kept[np.arange(20) % 5].tolist()
            assert epoch.behaviours[s, :5].tobytes() == last.behaviours[s, kept].tobytes()
            changed = epoch.behaviours[s] != last.behaviours[s, epoch.parent[s]]
            assert changed.any(axis=1).tolist() == [False] * 5 + [True] * 15


@pytest.mark.parametrize("wobble", [None, MASS, PAUSED])
def test_all_trials_of_an_epoch_are_of_the_morphology_of_that_epoch(wobble):
    for n, epoch in enumerate(learn(setup(wobble))):
        factor = wobble.factor(n) if wobble else 1.0
        assert (epoch.epoch, epoch.morphology) == (n, Morphology(mass=factor))
        height = 1 - ((epoch.behaviours - 0.3 * factor) ** 2).sum(axis=-1)
        assert epoch.performance == pytest.approx(height, abs=1e-14)


def test_the_best_is_the_best():
    for epoch in learn(setup(MASS)):
        assert epoch.performance[np.arange(3), epoch.best].tolist() == epoch.performance.max(axis=1).tolist()


def test_a_fixed_robot_never_gets_worse_and_learns():
    best = np.array([epoch.performance.max(axis=1) for epoch in learn(setup(epochs=150), seeds=range(10))])
    assert (np.diff(best, axis=0) >= 0).all()
    assert best[0].mean() < 0.95  # measured 0.89
    assert best[-1].min() > 0.9999  # measured 0.9999996; the top is 1


def test_direction_either_counts_the_size_of_the_displacement():
    forward, either = (learn(setup(epochs=1, direction=direction))[0] for direction in ("forward", "either"))
    assert (forward.performance < 0).any()
    assert either.performance.tolist() == np.abs(forward.performance).tolist()


def test_a_done_learner_refuses_to_go_on():
    learner = Learner(setup(epochs=2), [0], simulate=Landscape())
    assert len(epochs_of(learner)) == 2
    assert (learner.epoch, learner.done) == (2, True)
    with pytest.raises(ValueError, match="all 2 epochs have run"):
        learner.advance()


def test_no_seed_and_no_epoch_are_refused():
    with pytest.raises(ValueError, match="no seed"):
        Learner(setup(), [])
    with pytest.raises(ValueError, match="epochs must be at least 1, got 0"):
        setup(epochs=0)


# --- only the lanes that are needed ---------------------------------------------------------------------------------


@pytest.mark.parametrize("wobble", [None, MASS, PAUSED])
def test_one_call_an_epoch_with_the_new_behaviours_or_all_where_the_morphology_changed(wobble):
    landscape = Landscape()
    epochs = learn(setup(wobble), landscape=landscape)
    factors = [wobble.factor(n) if wobble else 1.0 for n in range(30)]
    changed = [n == 0 or factors[n] != factors[n - 1] for n in range(30)]
    assert landscape.lanes == [60 if all_again else 45 for all_again in changed]
    for epoch, all_again in zip(epochs, changed, strict=True):
        assert epoch.reused.sum(axis=1).tolist() == [0 if all_again else 5] * 3
        assert not epoch.reused[:, 5:].any()


def test_what_reuse_saves():
    lanes = {}
    for name, wobble in {"fixed": None, "wobbling": MASS, "paused": PAUSED}.items():
        learn(setup(wobble), landscape=(landscape := Landscape()))
        lanes[name] = sum(landscape.lanes)
    # 30 epochs of 20 trials, 5 less where the last epoch had the same robot: always but at first; from epoch 21 on; in
    # epochs 1..4, 9..12 and 17..29.
    assert lanes == {"fixed": 3 * (600 - 5 * 29), "wobbling": 3 * (600 - 5 * 9), "paused": 3 * (600 - 5 * 21)}


@pytest.mark.parametrize("wobble", [None, MASS, PAUSED])
def test_reused_outcomes_are_those_of_trying_again(wobble):
    ice = (0.6, 0.9)
    landscape = Landscape(ice)
    reused = learn(setup(wobble), landscape=Landscape(ice))
    tried = learn(setup(wobble), landscape=landscape, reuse=False)
    assert landscape.lanes == [60] * 30
    assert all_bits(reused, without=("reused",)) == all_bits(tried, without=("reused",))
    assert not any(epoch.reused.any() for epoch in tried)


# --- a run is its setup and its seed --------------------------------------------------------------------------------


@pytest.mark.parametrize("wobble", [None, MASS, PAUSED])
def test_bits_of_a_run_do_not_depend_on_the_seeds_beside_it(wobble):
    seeds = [4, 0, 17, 2, 2**70]
    together = learn(setup(wobble), seeds)
    for place, seed in enumerate(seeds):
        alone = learn(setup(wobble), [seed])
        assert all_bits(alone) == all_bits(together, slice(place, place + 1))
    backwards = learn(setup(wobble), seeds[::-1])
    assert all_bits(backwards, slice(None, None, -1)) == all_bits(together)


def test_more_epochs_go_on_from_fewer():
    fewer, more = learn(replace(setup(MASS, epochs=12), half=6)), learn(replace(setup(MASS), half=6))
    assert all_bits(fewer) == all_bits(more[:12])


def test_an_epoch_is_not_changed_by_the_epochs_after_it():
    learner = Learner(setup(), [0, 1], simulate=Landscape())
    first = learner.advance()
    before = bits(first)
    epochs_of(learner)
    assert bits(first) == before


# --- failure is data ------------------------------------------------------------------------------------------------


def test_diverged_trials_score_nan_and_rank_last():
    epochs = learn(setup(MASS), landscape=Landscape(ice=(0.5, 2.0)))
    assert (epochs[0].status == "diverged").mean() == pytest.approx(0.5, abs=0.15)
    for epoch in epochs:
        diverged = epoch.status == "diverged"
        assert (np.isnan(epoch.performance) == diverged).all()
        assert (np.isfinite(epoch.diverged_at) == diverged).all()
        assert ((epoch.limited == 3) == (epoch.performance > 0.5))[~diverged].all()
        assert not np.isnan(epoch.performance[np.arange(3), epoch.best]).any()
    for last, epoch in itertools.pairwise(epochs):
        for s in range(3):
            assert not np.isnan(last.performance[s, epoch.parent[s, :5]]).any()


def test_where_everything_diverges_the_best_is_nan_in_slot_0_and_the_run_goes_on():
    for epoch in learn(setup(MASS), landscape=Landscape(ice=(-1.0, 2.0))):
        assert epoch.best.tolist() == [0, 0, 0]
        assert np.isnan(epoch.performance).all()
        assert epoch.path.tolist() == [0.0, 0.0, 0.0]  # slot 0 is kept from slot 0: it never moved
        if epoch.epoch:
            assert (epoch.parent == np.arange(20) % 5).all()


def test_nan_fills_up_where_fewer_than_the_parents_are_finite():
    low = np.sort(initial_population(generator(0), Search(), GROUPS)[:, 0])[2]
    learner = Learner(setup(), [0], simulate=Landscape(ice=(low, 2.0)))
    first, second = learner.advance(), learner.advance()
    finite = np.flatnonzero(np.isfinite(first.performance[0]))
    assert len(finite) == 2
    nan_slots = [slot for slot in range(20) if slot not in finite]
    assert sorted(second.parent[0, :2]) == finite.tolist()
    assert second.parent[0, 2:5].tolist() == nan_slots[:3]
    assert np.isnan(second.performance[0, 2:5]).all()  # kept and reused, they stay NaN


# --- search distances -----------------------------------------------------------------------------------------------

# One group, three slots, one kept. Each row: the population, the slot each came from, and what the three are worth.
LINEAGE = [
    ([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], None, [1, 2, 0]),
    ([(1.0, 0.0), (1.3, 0.4), (1.0, 0.0)], [1, 1, 1], [0, 2, 1]),
    ([(1.3, 0.4), (4.3, 4.4), (1.3, 12.4)], [1, 1, 1], [0, 1, 2]),
    ([(1.3, 12.4), (1.3, 7.4), (4.3, 8.4)], [2, 2, 1], [0, 0, 3]),
    ([(4.3, 8.4), (5.3, 8.4), (10.3, 16.4)], [2, 2, 2], [4, 3, 1]),
]


@pytest.mark.parametrize(
    ("half", "path_before"),
    [
        (0, [0, 0, 0, 0, 0]),
        (1, [0, 0.5, 0.5, 0.5, 0.5]),
        (2, [0, 0.5, 12.5, 5.5, 5.5]),
        (3, [0, 0.5, 12.5, 9.5, 9.5]),
        (None, [0, 0.5, 12.5, 5.5, 5.5]),  # half of 5 epochs: 2
    ],
)
def test_both_search_distances_of_a_lineage_made_by_hand(monkeypatch, half, path_before):
    script = iter(LINEAGE[1:])

    def scripted(rng, population, performance, search):
        behaviours, parent, _ = next(script, LINEAGE[-1])
        return np.array(behaviours), np.array(parent)

    worth = iter(LINEAGE)

    def simulate(body, behaviours, **scene):
        return trials(next(worth)[2])

    monkeypatch.setattr(run, "offspring", scripted)
    body = Body.from_arrays([[0.0, 0.0], [1.0, 0.0]], [[0, 1]], stiffness=1.0, muscles=[(0, 0, 1)])
    chosen = replace(setup(epochs=5, population=3, parents=1), body=body, half=half)
    snapshot = Learner(chosen, [0]).snapshot()
    snapshot["behaviours"] = np.array([LINEAGE[0][0]])
    epochs = epochs_of(Learner.restored(chosen, [0], snapshot, reuse=False, simulate=simulate))

    assert [epoch.best[0] for epoch in epochs] == [1, 1, 2, 2, 0]
    # Epoch 2's best moved by (0, 12) from epoch 1's, epoch 3's by (0, 4) from the other one, that had moved by (3, 4).
    assert [epoch.path[0] for epoch in epochs] == pytest.approx([0, 0.5, 12.5, 9.5, 9.5])
    assert [epoch.path_before[0] for epoch in epochs] == pytest.approx(path_before)
    assert [epoch.step_distance[0] for epoch in epochs] == pytest.approx([math.nan, 0.5, 12, 5, 0], nan_ok=True)


@pytest.mark.parametrize("wobble", [None, MASS])
def test_search_distances_are_those_found_by_walking_back(wobble):
    chosen = setup(wobble, epochs=40)
    assert chosen.split == 20
    epochs = learn(chosen)
    for last, epoch in enumerate(epochs):
        for s in range(3):
            slot, path, before = epoch.best[s], 0.0, 0.0
            for n in range(last, 0, -1):
                parent = epochs[n].parent[s, slot]
                move = math.dist(epochs[n].behaviours[s, slot], epochs[n - 1].behaviours[s, parent])
                path, before, slot = path + move, before + move * (n <= 20), parent
            assert (epoch.path[s], epoch.path_before[s]) == pytest.approx((path, before), rel=1e-12)
    assert np.isnan(epochs[0].step_distance).all()
    for last, epoch in itertools.pairwise(epochs):
        for s in range(3):
            ends = last.behaviours[s, last.best[s]], epoch.behaviours[s, epoch.best[s]]
            assert epoch.step_distance[s] == pytest.approx(math.dist(*ends), rel=1e-12)


def test_offsets_count_as_the_numbers_they_are():
    # A landscape that rises with the second offset takes it past a whole turn: the path goes on growing.
    def slope(body, behaviours, **scene):
        return trials(behaviours[:, 3])

    chosen = setup(epochs=400)
    last = epochs_of(Learner(chosen, [0], simulate=slope))[-1]
    offset = last.behaviours[0, last.best[0], 3]
    assert offset > 3  # measured 8.3 turns, and a path of 9.2
    assert last.path[0] >= offset - 1


def test_where_the_path_is_split():
    assert setup(epochs=31).split == 15
    assert setup(MASS).split == MASS.end
    assert replace(setup(MASS), half=7).split == 7


def test_wobbling_explores_more_and_settles_after():
    wobble = Wobble("mass", amplitude=0.9, period=25, end=100)
    fixed, wobbling = (learn(setup(chosen, epochs=200), range(10))[-1] for chosen in (None, wobble))
    assert wobbling.path_before.mean() > 3 * fixed.path_before.mean()  # measured 2.74 and 0.62
    after = wobbling.path - wobbling.path_before
    assert after.mean() < 0.1 * wobbling.path_before.mean()  # measured 0.11


# --- stop and go on -------------------------------------------------------------------------------------------------


def through_a_file(snapshot: dict[str, np.ndarray], path) -> dict[str, np.ndarray]:
    np.savez(path, allow_pickle=False, **snapshot)
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


@pytest.mark.parametrize("wobble", [None, PAUSED])
@pytest.mark.parametrize("stop", [0, 1, 2, 13, 20, 29, 30])
def test_a_restored_learner_goes_on_with_the_same_bits(tmp_path, wobble, stop):
    chosen, ice = setup(wobble), (0.6, 0.9)
    whole = learn(chosen, [5, 6], landscape=Landscape(ice))
    learner = Learner(chosen, [5, 6], simulate=Landscape(ice))
    for _ in range(stop):
        learner.advance()
    snapshot = through_a_file(learner.snapshot(), tmp_path / "snapshot.npz")
    again = Learner.restored(chosen, [5, 6], snapshot, simulate=Landscape(ice))
    assert (again.epoch, again.done) == (stop, stop == 30)
    assert all_bits(epochs_of(again)) == all_bits(whole[stop:])


def test_a_snapshot_is_plain_arrays_and_stays_as_it_was():
    learner = Learner(setup(), [5, 6], simulate=Landscape())
    learner.advance()
    snapshot = learner.snapshot()
    assert all(type(array) is np.ndarray and array.dtype.kind in "fiuU" for array in snapshot.values())
    assert snapshot["generator"].dtype == np.uint64
    before = {name: array.tobytes() for name, array in snapshot.items()}
    epochs_of(learner)
    epochs_of(Learner.restored(setup(), [5, 6], snapshot, simulate=Landscape()))
    assert {name: array.tobytes() for name, array in snapshot.items()} == before


def test_writing_into_a_snapshot_touches_no_learner():
    learner = Learner(setup(), [5, 6], simulate=Landscape())
    learner.advance()
    snapshot = learner.snapshot()
    twin = Learner.restored(setup(), [5, 6], snapshot, simulate=Landscape())
    for array in snapshot.values():
        array[...] = 0
    whole = learn(setup(), [5, 6])
    assert all_bits(epochs_of(learner)) == all_bits(epochs_of(twin)) == all_bits(whole[1:])


def test_snapshots_of_a_learner_and_of_its_restored_twin_are_the_same():
    learner = Learner(setup(), [5, 6], simulate=Landscape())
    for _ in range(4):
        learner.advance()
    snapshot = learner.snapshot()
    twin = Learner.restored(setup(), [5, 6], snapshot).snapshot()
    assert {name: array.tobytes() for name, array in twin.items()} == {n: a.tobytes() for n, a in snapshot.items()}


def test_a_snapshot_of_something_else_is_refused():
    snapshot = Learner(setup(), [5, 6]).snapshot()
    with pytest.raises(ValueError, match=r"^learning: the snapshot's 'generator' has shape \(2, 6\), .*need \(3, 6\)"):
        Learner.restored(setup(), [5, 6, 7], snapshot)
    with pytest.raises(ValueError, match="'behaviours' has shape"):
        Learner.restored(setup(population=10), [5, 6], snapshot)
    del snapshot["path"]
    with pytest.raises(ValueError, match="has no 'path'"):
        Learner.restored(setup(), [5, 6], snapshot)


def test_an_interrupted_trial_leaves_the_learner_as_it_was():
    whole, landscape, calls = learn(setup(MASS)), Landscape(), iter(range(100))

    def interrupted(*args, **kwargs) -> Trials:
        if next(calls) % 3 == 1:
            raise KeyboardInterrupt
        return landscape(*args, **kwargs)

    learner, epochs = Learner(setup(MASS), [0, 1, 2], simulate=interrupted), []
    while not learner.done:
        try:
            epochs.append(learner.advance())
        except KeyboardInterrupt:
            learner = Learner.restored(setup(MASS), [0, 1, 2], learner.snapshot(), simulate=interrupted)
    assert all_bits(epochs) == all_bits(whole)


def test_epochs_and_setups_are_frozen():
    epoch = learn(setup(epochs=1))[0]
    for frozen, name in ((epoch, "epoch"), (setup(), "epochs")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(frozen, name, 7)
