"""Ranking, selection and perturbation: paper section II-B, `wobblesim/learning/search.py`."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from wobblesim.learning import search as search_module
from wobblesim.learning.search import (
    Search,
    generator,
    initial_population,
    offspring,
    perturbed,
    ranking,
    score,
    standard_normal,
)

NAN = math.nan
PAPER = Search()
GROUPS = 12
MANY = 20_000


def population(seed: int = 0) -> np.ndarray:
    return initial_population(generator(seed), PAPER, GROUPS)


def centred(n: int) -> np.ndarray:
    """Behaviours whose amplitudes no perturbation of scale 0.025 takes to a bound."""
    return np.full((n, 2 * GROUPS), 0.5)


# --- random numbers -------------------------------------------------------------------------------------------------


def test_initial_population_is_the_seeds_whatever_the_search():
    other = Search(parents=3, rate=0.9, scale=1.0, direction="either")
    assert population(7).tobytes() == initial_population(generator(7), other, GROUPS).tobytes()
    assert population(7).tobytes() != population(8).tobytes()


def test_initial_population_fills_the_unit_cube():
    everything = np.stack([population(seed) for seed in range(100)])
    assert everything.shape == (100, 20, 24)
    assert 0.0 <= everything.min() < 1e-4  # measured 1.4e-6
    assert 1 - 1e-4 < everything.max() < 1.0  # measured 1 - 5.1e-6
    assert everything.mean(axis=(0, 1)) == pytest.approx(np.full(24, 0.5), abs=0.03)  # measured 0.012


def test_first_number_of_seed_0_is_that_of_pcg64():
    assert population(0)[0, 0] == 0.6369616873214543


def test_logarithm_is_within_two_units_in_the_last_place():
    x = np.concatenate([np.logspace(-300, 300, 4001), 1.0 - np.logspace(-16, -0.31, 2001), [1.0, 2.0**-53, 0.5, 2.0]])
    exact = np.array([math.log(value) for value in x])
    error = np.abs(search_module._log(x) - exact) / np.spacing(np.abs(exact))
    assert error.max() <= 3.0  # measured 2.0; 1.8 against mpmath


def test_normal_numbers_are_those_of_box_and_muller():
    radius, turns = generator(3).random((2, 40, 24))
    twin = [
        math.sqrt(-2 * math.log1p(-r)) * math.sin(2 * math.pi * t) for r, t in zip(radius.flat, turns.flat, strict=True)
    ]
    assert standard_normal(generator(3), (40, 24)).ravel() == pytest.approx(twin, abs=1e-14)  # measured 2.0e-15


def test_normal_numbers_are_normal():
    z = standard_normal(generator(0), (1_000_000,))
    assert abs(z.mean()) < 0.003  # measured 0.0003, standard error 0.001
    assert abs(z.std() - 1) < 0.002  # measured 0.0002, standard error 0.0007
    assert abs(stats.kurtosis(z)) < 0.015  # measured 0.0003, standard error 0.005
    assert np.mean(np.abs(z) > 3) == pytest.approx(2.70e-3, abs=0.16e-3)  # measured 2.79e-3, standard error 0.05e-3
    assert stats.kstest(z, "norm").pvalue > 0.01  # measured 0.50


BITS = """
import hashlib
import numpy as np
from wobblesim.learning.search import Search, generator, initial_population, offspring, standard_normal
from wobblesim.learning.wobble import Wobble
rng, digest = generator(1), hashlib.sha256()
population = initial_population(rng, Search(), 12)
for _ in range(50):
    population, _ = offspring(rng, population, population.sum(axis=1), Search())
digest.update(population.tobytes())
digest.update(standard_normal(rng, (100_000,)).tobytes())
digest.update(Wobble("mass", 0.3, 25).factor(np.arange(4000)).tobytes())
print(digest.hexdigest())
"""

GOLDEN = "56b894a6124e308f25c24e37251fe6de954726c9ba1975b66b1a32d21bfce7fd"


def _plainer_cpu() -> dict[str, str]:
    """Environment in which NumPy and the C library choose the code they have for an older CPU."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    disabled = [name for name in __cpu_dispatch__ if __cpu_features__.get(name)]
    hwcaps = "-AVX2_Usable,-AVX2,-FMA_Usable,-FMA,-FMA4,-AVX512F,-AVX512VL"
    return {"NPY_DISABLE_CPU_FEATURES": " ".join(disabled), "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={hwcaps}"}


def test_bits_do_not_depend_on_the_cpu():
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    digests = [
        subprocess.run(
            [sys.executable, "-c", BITS], env={**environment, **cpu}, check=True, capture_output=True, text=True
        ).stdout.strip()
        for cpu in ({}, _plainer_cpu())
    ]
    assert digests == [GOLDEN] * 2


# --- ranking --------------------------------------------------------------------------------------------------------


def test_ranking_by_hand():
    assert ranking(np.array([0.5, NAN, 2.0, 0.5, -1.0, NAN, 2.0])).tolist() == [2, 6, 0, 3, 4, 1, 5]


@given(st.lists(st.sampled_from([-2.0, -0.0, 0.0, 0.5, 3.0, -math.inf, NAN]), min_size=1, max_size=40))
def test_ranking_is_best_first_nan_last_ties_by_slot(performance):
    expected = sorted(
        range(len(performance)),
        key=lambda slot: (math.isnan(p := performance[slot]), 0.0 if math.isnan(p) else -p, slot),
    )
    assert ranking(np.array(performance)).tolist() == expected


def test_score_is_the_displacement_or_its_size():
    displacement = np.array([1.5, -2.0, NAN])
    np.testing.assert_array_equal(score(displacement, "forward"), [1.5, -2.0, NAN])
    np.testing.assert_array_equal(score(displacement, "either"), [1.5, 2.0, NAN])


# --- selection ------------------------------------------------------------------------------------------------------


def test_the_best_are_kept_bit_for_bit_best_first():
    tried, performance = population(), generator(1).random(20)
    bred, parent = offspring(generator(2), tried, performance, PAPER)
    best = np.argsort(performance)[::-1][:5]
    assert parent[:5].tolist() == best.tolist()
    assert bred[:5].tobytes() == tried[best].tobytes()


def test_child_i_is_made_from_kept_i_mod_parents():
    # Behaviours far apart, perturbations small: the nearest one is the one it was made from.
    search = Search(rate=1.0, scale=1e-6)
    tried, performance = population(), generator(1).random(20)
    bred, parent = offspring(generator(2), tried, performance, search)
    nearest = np.abs(bred[:, None] - tried).max(axis=2).argmin(axis=1)
    assert parent.tolist() == nearest.tolist()
    assert parent[5:].tolist() == [parent[i % 5] for i in range(15)]


def test_fewer_parents_than_slots_left_wrap_unevenly():
    _, parent = offspring(generator(0), population()[:7], np.arange(7.0), Search(population=7, parents=3))
    assert parent.tolist() == [6, 5, 4, 6, 5, 4, 6]


def test_nan_is_kept_only_to_fill_up_by_slot():
    performance = np.full(20, NAN)
    performance[[11, 4]] = [1.0, -3.0]
    _, parent = offspring(generator(0), population(), performance, PAPER)
    assert parent[:5].tolist() == [11, 4, 0, 1, 2]


def test_ties_are_kept_by_slot():
    _, parent = offspring(generator(0), population(), np.zeros(20), PAPER)
    assert parent[:5].tolist() == [0, 1, 2, 3, 4]


def test_offspring_leaves_its_arguments_alone():
    tried, performance = population(), generator(1).random(20)
    before = tried.tobytes(), performance.tobytes()
    bred, _ = offspring(generator(2), tried, performance, PAPER)
    bred[:] = 0.0
    assert (tried.tobytes(), performance.tobytes()) == before


# --- perturbation ---------------------------------------------------------------------------------------------------


def test_every_child_differs_from_its_parent():
    rng, tried = generator(4), population()
    for _ in range(300):
        bred, parent = offspring(rng, tried, rng.random(20), PAPER)
        assert (bred[5:] != tried[parent[5:]]).any(axis=1).all()
        tried = bred


@pytest.mark.parametrize("bound", [0.0, 1.0])
def test_a_child_of_clipped_amplitudes_differs_too(bound):
    # At this rate one coordinate is touched; half of those are amplitudes, and half of these are pushed outward.
    search = Search(rate=1e-9)
    tried = np.full((MANY, 24), bound)
    changed = perturbed(generator(5), tried, search)
    assert ((changed != tried).sum(axis=1) == 1).all()
    amplitudes = (changed != tried)[:, :12].any(axis=1).mean()
    assert amplitudes == pytest.approx(1 / 3, abs=0.015)  # 1/4 of 3/4 of the attempts; measured 0.338 twice


@pytest.mark.parametrize("rate", [0.02, 0.1, 0.5, 1.0])
def test_each_coordinate_is_touched_at_the_rate_and_one_at_least(rate):
    touched = perturbed(generator(6), centred(MANY), Search(rate=rate)) != 0.5
    expected = rate + (1 - rate) ** 24 / 24  # an empty row gets one of 24
    assert touched.any(axis=1).all()
    standard_error = math.sqrt(expected * (1 - expected) / MANY)
    # measured, largest of 24: 1.8, 2.3, 2.2 and 0 standard errors
    assert touched.mean(axis=0) == pytest.approx(np.full(24, expected), abs=4 * standard_error + 1e-12)


@pytest.mark.parametrize("scale", [0.002, 0.025, 0.1])
def test_touched_coordinates_move_normally_with_the_scale(scale):
    moves = perturbed(generator(7), centred(MANY), Search(scale=scale)) - 0.5
    moves = moves[moves != 0.0] / scale  # 49,413 of them
    assert abs(moves.mean()) < 0.015  # measured 0.0058, standard error 0.0045
    assert moves.std() == pytest.approx(1.0, abs=0.01)  # measured 1.0006, standard error 0.0032
    assert stats.kstest(moves, "norm").pvalue > 0.01  # measured 0.51


def test_coordinates_are_touched_independently():
    touched = perturbed(generator(8), centred(MANY), Search(rate=0.3)) != 0.5
    correlation = np.corrcoef(touched.T) - np.eye(24)
    assert np.abs(correlation).max() < 0.03  # measured 0.019; standard error 0.007, 276 pairs


def test_amplitudes_are_clipped_and_offsets_are_free():
    changed = perturbed(generator(9), population().repeat(50, axis=0), Search(rate=1.0, scale=2.0))
    amplitudes, offsets = np.split(changed, 2, axis=1)
    assert amplitudes.min() == 0.0
    assert amplitudes.max() == 1.0
    assert offsets.min() < -1.0
    assert offsets.max() > 2.0
    assert ((offsets < 0) | (offsets >= 1)).mean() > 0.5  # measured 0.81


# --- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"parents": 0}, "parents must be at least 1"),
        ({"parents": 20}, "fewer than the population of 20"),
        ({"population": 5}, "fewer than the population of 5"),
        ({"rate": 0.0}, "rate"),
        ({"rate": 1.1}, "rate"),
        ({"rate": NAN}, "rate"),
        ({"scale": 0.0}, "scale"),
        ({"scale": -0.1}, "scale"),
        ({"scale": math.inf}, "scale"),
        ({"scale": NAN}, "scale"),
        ({"direction": "up"}, "forward, either"),
    ],
)
def test_a_search_that_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(ValueError, match=f"^search: .*{message}"):
        Search(**wrong)
