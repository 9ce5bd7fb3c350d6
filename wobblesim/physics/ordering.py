"""Orders found once per body: in which springs are visited, and in which nodes are eliminated.

Both work for any body; neither knows what a starfish is.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]


def _levels(pairs: Ints, n_nodes: int) -> Ints:
    """Level of each pair: one more than the highest level before it that shares a node."""
    last = np.zeros(n_nodes, dtype=np.int64)
    level = np.empty(len(pairs), dtype=np.int64)
    for s, (a, b) in enumerate(pairs):
        level[s] = last[a] = last[b] = max(last[a], last[b]) + 1
    return level


def schedule_springs(springs: Ints, n_nodes: int) -> Ints:
    """Order in which to visit springs one after the other, interleaving independent parts of the body.

    Two springs that share a node keep their order, so a sequential method (`impulse`) computes the same bits as
    in creation order. Springs of one level share no node: the processor works on several at once instead of
    waiting for each result.

    Parameters
    ----------
    springs : (n_springs, 2) int

    Returns
    -------
    (n_springs,) int
        Spring indices, level by level.
    """
    return np.argsort(_levels(springs, n_nodes), kind="stable")


@dataclass(frozen=True)
class Elimination:
    """Symbolic block LDLᵀ factorisation of a body's matrix: one 2x2 block for each pair of coupled nodes.

    Attributes
    ----------
    order : (n_nodes,) int
        Nodes in elimination order.
    first : (n_nodes + 1,) int
        The blocks of the p-th eliminated node are ``first[p] .. first[p + 1]``.
    row : (n_blocks,) int
        The later node (by its place in the elimination order) that a block couples to, ascending.
    column : (n_blocks,) int
        The earlier one, whose block it is.
    left_first : (n_nodes + 1,) int
        Start, in `left`, of the blocks that earlier nodes have with a node.
    left : (n_blocks,) int
        Blocks sorted by row, then column.
    pair_first : (n_blocks + 1,) int
        Start, in `pairs`, of what earlier nodes change in a block.
    pairs : (n_pairs, 2) int
        For a block of p and q, and an earlier node coupled to both: its blocks with p and with q.
    fill : int
        Blocks that no spring needs.
    """

    order: Ints
    first: Ints
    row: Ints
    column: Ints
    left_first: Ints
    left: Ints
    pair_first: Ints
    pairs: Ints
    fill: int

    @property
    def n_blocks(self) -> int:
        """Off-diagonal blocks, fill included."""
        return len(self.row)


def eliminate(springs: Ints, n_nodes: int) -> Elimination:
    """Find an elimination order by minimum degree and the structure of its factors.

    The node with the fewest coupled nodes goes first (for an arm: from tip to centre), ties by node number
    (Tinney & Walker 1967, scheme 2). The order is then sorted by height in the elimination tree, which leaves
    the factors' structure as it is and interleaves the independent arms.

    Parameters
    ----------
    springs : (n_springs, 2) int
    """
    return _eliminate(np.ascontiguousarray(springs, dtype=np.int64).tobytes(), n_nodes)


@functools.lru_cache(maxsize=32)  # 3 ms for the starfish, needed again at every epoch of every run
def _eliminate(spring_bytes: bytes, n_nodes: int) -> Elimination:
    coupled = _couplings(np.frombuffer(spring_bytes, dtype=np.int64).reshape(-1, 2), n_nodes)
    n_spring_blocks = sum(map(len, coupled)) // 2
    later = _minimum_degree(coupled)
    order = _by_height(later)
    place = np.empty(n_nodes, dtype=np.int64)
    place[order] = np.arange(n_nodes)

    rows = [sorted(int(place[q]) for q in later[p]) for p in order]
    first = _starts(map(len, rows))
    block = {(p, q): int(first[p]) + j for p, row in enumerate(rows) for j, q in enumerate(row)}
    pairs: list[list[tuple[int, int]]] = [[] for _ in block]
    for s, row in enumerate(rows):
        for p, q in itertools.combinations(row, 2):
            pairs[block[p, q]].append((block[s, p], block[s, q]))
    column, row = np.array(list(block), dtype=np.int64).reshape(-1, 2).T.copy()
    return Elimination(
        order=order,
        first=first,
        row=row,
        column=column,
        left_first=_starts(np.bincount(row, minlength=n_nodes)),
        left=np.argsort(row, kind="stable"),
        pair_first=_starts(map(len, pairs)),
        pairs=np.array(list(itertools.chain(*pairs)), dtype=np.int64).reshape(-1, 2),
        fill=len(block) - n_spring_blocks,
    )


def _starts(counts: Iterable[int]) -> Ints:
    """Where each of some consecutive parts begins, and where the last one ends."""
    return np.array([0, *itertools.accumulate(counts)], dtype=np.int64)


def _couplings(springs: Ints, n_nodes: int) -> list[set[int]]:
    coupled: list[set[int]] = [set() for _ in range(n_nodes)]
    for a, b in springs.tolist():
        coupled[a].add(b)
        coupled[b].add(a)
    return coupled


def _minimum_degree(coupled: list[set[int]]) -> dict[int, set[int]]:
    """Each node's still uneliminated neighbours at its elimination, in elimination order."""
    graph = {node: set(neighbours) for node, neighbours in enumerate(coupled)}
    later: dict[int, set[int]] = {}
    while graph:
        node = min(graph, key=lambda p: (len(graph[p]), p))
        neighbours = later[node] = graph.pop(node)
        for q in neighbours:
            graph[q] |= neighbours
            graph[q] -= {node, q}
    return later


def _by_height(later: dict[int, set[int]]) -> Ints:
    """Sort by height in the elimination tree: children still come before their parents."""
    turn = {node: i for i, node in enumerate(later)}
    height = dict.fromkeys(later, 0)
    for node, neighbours in later.items():
        if neighbours:
            parent = min(neighbours, key=turn.__getitem__)
            height[parent] = max(height[parent], height[node] + 1)
    return np.array(sorted(later, key=lambda node: (height[node], turn[node])), dtype=np.int64)
