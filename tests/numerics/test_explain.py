"""What `wobblesim explain` says of terms, trials, memory and disk, against the simulator, the learner and the store."""

import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scenes import random_behaviours, triangle
from study.toy import study as toy_study
from study.toy import toy

import wobblesim as ws
from wobblesim.analysis.tables import load
from wobblesim.config import columns
from wobblesim.learning.run import Setup
from wobblesim.learning.search import Search
from wobblesim.learning.wobble import Wobble
from wobblesim.numerics import explain_terms as terms
from wobblesim.numerics.explain import Probes, call_seconds, keep_books, still_epochs, trial_bytes
from wobblesim.physics.simulate import full_block
from wobblesim.study.execute import sweep
from wobblesim.study.plan import study as lay_out

DT = {"midpoint": 0.01, "impulse": 0.005, "explicit": 5e-4}


def setup(integrator="midpoint", body=None, **changes):
    """A condition of a robot of three nodes that starts above the floor."""
    if body is None:
        body = replace(triangle(), position=np.add(triangle().position, [0.0, 1.0]))
    physics = ws.Physics(integrator=integrator, dt=DT[integrator])
    made = Setup(body, ws.Scene(), physics, ws.Gait(), duration=1.0, search=Search(), wobble=None, epochs=10)
    return replace(made, **changes)


# --- terms -----------------------------------------------------------------------------------------------------


def compiled_in(made):
    return {name for name, state in terms.states(made).items() if state == terms.IN}


@pytest.mark.parametrize("integrator", DT)
def test_a_full_scene_leaves_out_nothing(integrator):
    states = terms.states(setup(integrator))
    assert states.pop("damping") == (terms.NO_CODE if integrator == "impulse" else terms.IN)
    assert set(states.values()) == {terms.IN}


@pytest.mark.parametrize("integrator", DT)
def test_what_a_scene_does_not_have_is_left_out(integrator):
    full = compiled_in(setup(integrator))
    frictionless, undamped = (
        replace(triangle(), friction=np.zeros(3)),
        replace(triangle(), damping_ratio=np.zeros(3)),
    )
    elastic = ws.Floor(restitution=0.0 if integrator == "impulse" else 1.0)
    assert full - compiled_in(setup(integrator, frictionless)) == {"friction"}
    assert full - compiled_in(setup(integrator, undamped)) == full & {"damping"}
    assert full - compiled_in(setup(integrator, scene=ws.Scene(gravity=0.0))) == {"gravity"}
    assert full - compiled_in(setup(integrator, scene=ws.Scene(floor=elastic))) == {"restitution"}
    flight = setup(integrator, scene=ws.Scene(floor=None))
    assert full - compiled_in(flight) == {"floor", "friction", "restitution"}
    assert terms.states(flight)["friction"] == terms.LEFT_OUT


@pytest.mark.parametrize("integrator", DT)
def test_the_step_that_an_integrator_refuses_without_damping_has_terms_all_the_same(integrator):
    assert terms.states(setup(integrator, physics=ws.Physics(integrator=integrator, dt=1.0)))["gravity"] == terms.IN


@pytest.mark.nightly  # 18 kernels to compile
@pytest.mark.parametrize("integrator", DT)
@pytest.mark.parametrize("term", sorted(terms.SIZED.keys() - {"floor"}))
def test_a_faint_term_moves_nothing(term, integrator):
    # This is what a cost is the difference of: the same motion with and without the term.
    ends = []
    for size in (terms.FAINT, 0.0):
        made = terms.SIZED[term](setup(integrator), size)
        behaviours = np.full((1, 2 * made.body.n_groups), 0.3)
        options = {"scene": made.scene, "physics": made.physics, "gait": made.gait, "record_every": 10}
        ends.append(ws.simulate(made.body, behaviours, duration=0.3, width=16, **options).positions)
    # restitution 1 - 1e-12 of `midpoint` and `explicit` leaves 1e-12 of the dashpot: the same bits in float32
    np.testing.assert_array_equal(*ends)


# --- trials, disk, memory, time ----------------------------------------------------------------------------------


RESTING = "conditions.mass.wobble={dimension: mass, amplitude: 0.3, period: 5, end: 9, upper_bound: 1.0}"


@pytest.mark.parametrize("change", ["log=trials", RESTING])
def test_reused_trials_are_those_of_the_table(tmp_path, change):
    config = toy_study(change)
    sweep(config, tmp_path, simulate=toy)
    counted = load(tmp_path).runs().groupby("condition")["reused"].sum()
    for name, made in lay_out(config).setups.items():
        assert 4 * 5 * still_epochs(made) == counted[name] > 0  # seeds, parents


def test_a_wobble_that_its_bound_flattens_rests_more_often():
    wobble = {"dimension": "mass", "amplitude": 0.3, "period": 8, "end": 8, "decay_start": 8}
    # sin(2 pi n/8) is 0 at n = 0 and 4; with the bound the factor is 1 from 0 to 4 and again from 8 on
    assert still_epochs(setup(wobble=Wobble(**wobble, upper_bound=1.0), epochs=10)) == 5
    assert still_epochs(setup(wobble=Wobble(**wobble), epochs=10)) == 1  # from 8 to 9
    assert still_epochs(setup(wobble=None, epochs=10)) == 9


@pytest.mark.parametrize("log", ["epochs", "behaviours"])
def test_the_disk_it_takes_is_that_of_a_sweep(tmp_path, log):
    config = toy_study(f"log={log}", "learning.epochs=400")
    sweep(config, tmp_path, simulate=toy)
    laid_out = lay_out(config)
    stored = {name: columns(parameters) for name, parameters in laid_out.conditions.items()}
    probes = Probes(laid_out, stored, threads=1)
    foreseen = sum(4 * probes.books(name, 4).bytes_of(400) for name in laid_out.conditions)
    found = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    assert 0.8 < foreseen / found < 1.25  # measured 0.88 and 0.92


def test_what_is_logged_is_counted_in_full():
    laid_out = lay_out(toy_study("log=behaviours", "learning.epochs=4"))
    books = keep_books(laid_out, "fixed", {}, seeds=2)
    genes, slots = 2 * laid_out.setups["fixed"].body.n_groups, 20
    assert books.logged > 8 * genes * slots  # the genotypes alone
    assert books.epoch > 0
    assert books.commit > 0
    assert books.bytes_of(4) > 0


@pytest.mark.parametrize("integrator", DT)
@pytest.mark.parametrize("n_trials", [1, 100])
def test_the_memory_of_a_call_is_what_it_allocates(integrator, n_trials):
    robot = ws.starfish(arms=3, sections=2)
    made = setup(integrator, robot, physics=ws.Physics(integrator=integrator, dt=2e-4), duration=0.02)
    behaviours = random_behaviours(0, n_trials, robot.n_groups)

    def call():
        options = {"scene": made.scene, "physics": made.physics, "gait": made.gait}
        width = full_block(made.physics)
        ws.simulate(robot, behaviours, duration=made.duration, threads=1, width=width, **options)

    call()  # what is kept between calls, and the kernel
    tracemalloc.start()
    call()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 0.5 < trial_bytes(made, n_trials, threads=1) / most < 2.0  # measured 0.58 to 0.87


def test_the_time_of_a_long_call_is_foreseen_from_a_short_one():
    made = setup(duration=1000.0)
    behaviours = random_behaviours(0, 16, 2)
    call_seconds(made, 16, 1)
    begun = time.perf_counter()
    ws.simulate(made.body, behaviours, physics=made.physics, duration=made.duration, threads=1)
    real = time.perf_counter() - begun
    assert 0.1 < call_seconds(made, 16, 1) / real < 10  # measured 0.98 and 1.00; the machine may be busy
