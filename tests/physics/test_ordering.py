"""Orders found once per body: visits of springs, and the elimination of nodes. For any graph, and for the starfish."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import random_behaviours, random_body

import wobblesim as ws
from wobblesim.physics import impulse
from wobblesim.physics.ordering import eliminate, schedule_springs


@st.composite
def graphs(draw, most_nodes=12):
    """Springs (springs, 2) between random nodes, some doubled, and the number of nodes; some may have no spring."""
    n = draw(st.integers(1, most_nodes))
    pair = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda ends: ends[0] != ends[1])
    springs = draw(st.lists(pair, max_size=40)) if n > 1 else []
    return np.array(springs, dtype=np.int64).reshape(-1, 2), n


# --- visits of springs ---------------------------------------------------------------------------------------------


@given(graphs())
def test_schedule_keeps_the_order_of_springs_that_share_a_node(graph):
    springs, n = graph
    order = schedule_springs(springs, n)
    assert sorted(order) == list(range(len(springs)))
    for node in range(n):
        of_node = [s for s in order if node in springs[s]]
        assert of_node == sorted(of_node)


def test_schedule_interleaves_the_arms_of_the_starfish():
    springs = ws.starfish().springs
    order = schedule_springs(springs, 108)
    apart = [not set(springs[s]) & set(springs[t]) for s, t in pairwise(order)]
    as_built = [not set(a) & set(b) for a, b in pairwise(springs)]
    assert sum(apart) > 2 * sum(as_built)  # measured 252 and 102, of 269 pairs of neighbours


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("body", [random_body(51), ws.starfish()], ids=["random", "starfish"])
def test_impulse_has_the_same_bits_in_the_order_of_creation(body, precision, monkeypatch):
    def positions():
        physics = ws.Physics(integrator="impulse", dt=0.005, precision=precision)
        behaviours = random_behaviours(52, 3, body.n_groups)
        # a body of its own: what is prepared for one is kept
        return ws.simulate(replace(body), behaviours, physics=physics, duration=0.5, record_every=10).positions

    scheduled = positions()
    as_created, asked = np.arange(body.n_springs), []

    def creation_order(springs, n_nodes):
        asked.append(len(springs))
        return as_created[: len(springs)]

    monkeypatch.setattr(impulse, "schedule_springs", creation_order)
    created = positions()
    assert asked
    assert not np.array_equal(schedule_springs(body.springs, body.n_nodes), as_created)
    np.testing.assert_array_equal(scheduled, created)


# --- elimination of nodes ------------------------------------------------------------------------------------------


@given(graphs())
def test_elimination_has_a_block_for_every_spring_and_every_update(graph):
    springs, n = graph
    plan = eliminate(springs, n)
    assert sorted(plan.order) == list(range(n))
    assert (plan.row > plan.column).all()
    np.testing.assert_array_equal(np.bincount(plan.column, minlength=n), np.diff(plan.first))
    np.testing.assert_array_equal(np.bincount(plan.row, minlength=n), np.diff(plan.left_first))
    blocks = list(zip(plan.column.tolist(), plan.row.tolist(), strict=True))
    assert blocks == sorted(set(blocks))
    assert sorted(plan.left) == list(range(plan.n_blocks))
    assert (np.diff(plan.row[plan.left]) >= 0).all()
    turn = np.argsort(plan.order)
    joined = {tuple(sorted(turn[spring].tolist())) for spring in springs}
    assert joined <= set(blocks)
    assert plan.fill == len(blocks) - len(joined)
    for e, (p, q) in enumerate(blocks):
        both = {c for c, r in blocks if r == p} & {c for c, r in blocks if r == q}
        changes = plan.pairs[plan.pair_first[e] : plan.pair_first[e + 1]].tolist()
        assert [(blocks[f], blocks[g]) for f, g in changes] == [((c, p), (c, q)) for c in sorted(both)]


def test_elimination_of_the_starfish_fills_two_blocks():
    plan = eliminate(ws.starfish().springs, 108)
    assert plan.n_blocks == 266
    assert plan.fill == 2


@pytest.mark.parametrize("n", [3, 4, 10])
def test_elimination_fills_nothing_in_a_chain_and_a_fan_of_a_ring(n):
    chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    ring = np.concatenate([chain, [(0, n - 1)]])
    assert eliminate(chain, n).fill == 0
    assert eliminate(ring, n).fill == n - 3


def random_matrix(springs, n, rng):
    """A symmetric positive definite matrix (2 n, 2 n) that couples the nodes of a spring, as `midpoint` builds it."""
    matrix = np.diag(np.repeat(rng.uniform(0.5, 2, n), 2))
    for a, b in springs:
        angle = rng.uniform(0, 2 * np.pi)
        unit = np.array([np.cos(angle), np.sin(angle)])
        rows = np.array([2 * a, 2 * a + 1, 2 * b, 2 * b + 1])
        stretch = np.concatenate([-unit, unit])
        matrix[rows[:, None], rows] += rng.uniform(0, 10) * np.outer(stretch, stretch)
    return matrix


def solve(plan, matrix, rhs):
    """Block LDLᵀ by the plan, looking left: only the plan's blocks are ever looked at."""
    n = len(plan.order)
    blocks = matrix.reshape(n, 2, n, 2).swapaxes(1, 2)[np.ix_(plan.order, plan.order)]
    diagonal, factor = blocks[range(n), range(n)], blocks[plan.row, plan.column]
    x = rhs.reshape(n, 2)[plan.order]
    for p in range(n):
        for e in plan.left[plan.left_first[p] : plan.left_first[p + 1]]:
            scaled = factor[e] @ diagonal[plan.column[e]]
            diagonal[p] -= scaled @ factor[e].T
            x[p] -= scaled @ x[plan.column[e]]
        x[p] = np.linalg.solve(diagonal[p], x[p])
        for e in range(plan.first[p], plan.first[p + 1]):
            for f, g in plan.pairs[plan.pair_first[e] : plan.pair_first[e + 1]]:
                factor[e] -= factor[g] @ diagonal[plan.column[f]] @ factor[f].T
            factor[e] = factor[e] @ np.linalg.inv(diagonal[p])
    for p in reversed(range(n)):
        for e in range(plan.first[p], plan.first[p + 1]):
            x[p] -= factor[e].T @ x[plan.row[e]]
    return x[np.argsort(plan.order)].ravel()


@given(graphs(), st.integers(0, 2**32 - 1))
def test_solving_by_the_plan_is_solving_the_dense_system(graph, seed):
    (springs, n), rng = graph, np.random.default_rng(seed)
    matrix, rhs = random_matrix(springs, n, rng), rng.normal(size=2 * n)
    exact = np.linalg.solve(matrix, rhs)
    np.testing.assert_allclose(solve(eliminate(springs, n), matrix, rhs), exact, rtol=0, atol=1e-12)
