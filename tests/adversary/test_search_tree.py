from __future__ import annotations

from collections import deque

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from skd_adversary.pomdp.tree import (
    CHILDREN,
    FIRST_CHILD,
    VALUE,
    VISITS,
    SearchTree,
    add_child,
    clear_node,
    copy_subtree,
    empty_tree,
    most_alike_child,
    nearest_child,
)

ACTIONS, DIMENSION = 3, 2


def _random_tree(nodes: int, rng: np.random.Generator) -> SearchTree:
    """Every node but the root hangs below a random earlier one, as a random action's newest child."""
    tree = empty_tree(nodes, ACTIONS, DIMENSION)
    for node in range(nodes):
        clear_node(tree, node)
        tree.total[node] = rng.integers(1, 100)
        tree.statistics[node, :, VALUE] = rng.normal(size=ACTIONS)
        tree.statistics[node, :, VISITS] = rng.integers(0, 9, ACTIONS)
        tree.observation[node] = rng.normal(size=DIMENSION)
        if node:
            parent, action = rng.integers(node), rng.integers(ACTIONS)
            tree.sibling[node] = tree.links[parent, action, FIRST_CHILD]
            tree.links[parent, action, FIRST_CHILD] = node
            tree.links[parent, action, CHILDREN] += 1
    return tree


def _children(tree: SearchTree, node: int, action: int) -> list[int]:
    found = []
    child = int(tree.links[node, action, FIRST_CHILD])
    for _ in range(tree.links[node, action, CHILDREN]):
        found.append(child)
        child = int(tree.sibling[child])
    return found


def _same(tree: SearchTree, node: int, other: SearchTree, twin: int) -> None:
    """Both subtrees hold the same, whatever the order of siblings."""
    pairs = deque([(node, twin)])
    while pairs:
        a, b = pairs.popleft()
        assert tree.total[a] == other.total[b]
        assert (tree.statistics[a] == other.statistics[b]).all()
        for action in range(ACTIONS):
            ours = sorted(_children(tree, a, action), key=lambda k: tuple(tree.observation[k]))
            theirs = sorted(_children(other, b, action), key=lambda k: tuple(other.observation[k]))
            assert len(ours) == len(theirs)
            for x, y in zip(ours, theirs, strict=True):
                assert (tree.observation[x] == other.observation[y]).all()
                pairs.append((x, y))


def _size(tree: SearchTree, root: int) -> int:
    count, nodes = 0, deque([root])
    while nodes:
        node = nodes.popleft()
        count += 1
        for action in range(ACTIONS):
            nodes.extend(_children(tree, node, action))
    return count


@given(nodes=st.integers(1, 60), seed=st.integers(0, 2**32 - 1), data=st.data())
def test_a_copied_subtree_is_the_subtree(nodes: int, seed: int, data: st.DataObject) -> None:
    tree = _random_tree(nodes, np.random.default_rng(seed))
    root = data.draw(st.integers(0, nodes - 1))
    kept = _random_tree(nodes, np.random.default_rng(seed + 1))  # what was there before does not matter
    count = copy_subtree(tree, root, kept, nodes, np.zeros(nodes, np.int32))
    assert count == _size(tree, root) == _size(kept, 0)
    _same(tree, root, kept, 0)


@given(nodes=st.integers(2, 60), seed=st.integers(0, 2**32 - 1), room=st.integers(1, 20))
def test_what_does_not_fit_is_left_out_from_below(nodes: int, seed: int, room: int) -> None:
    tree = _random_tree(nodes, np.random.default_rng(seed))
    kept = empty_tree(nodes, ACTIONS, DIMENSION)
    count = copy_subtree(tree, 0, kept, room, np.zeros(nodes, np.int32))
    assert count == min(room, nodes) == _size(kept, 0)
    assert (kept.statistics[0] == tree.statistics[0]).all()


@given(nodes=st.integers(2, 60), seed=st.integers(0, 2**32 - 1))
def test_nearest_child_is_the_nearest(nodes: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = _random_tree(nodes, rng)
    seen = rng.normal(size=DIMENSION).astype(np.float32)
    for action in range(ACTIONS):
        child, squared = nearest_child(tree, 0, action, seen)
        known = _children(tree, 0, action)
        if not known:
            assert (child, squared) == (-1, np.inf)
            continue
        distances = [float(np.sum((tree.observation[k].astype(float) - seen) ** 2)) for k in known]
        np.testing.assert_allclose(squared, min(distances), rtol=1e-5)
        np.testing.assert_allclose(distances[known.index(child)], min(distances), rtol=1e-5)


def test_of_children_that_are_equally_alike_the_newest_is_taken() -> None:
    tree = empty_tree(4, 1, 1, references=2, state_dim=1)
    seen = np.zeros(1, np.float32)
    for child in (1, 2, 3):
        add_child(tree, 0, 0, child, seen)
    tree.profile[1:] = [[1.0, 0.0], [0.6, 0.8], [0.6, 0.8]]
    child, apart = most_alike_child(tree, 0, 0, 2, np.array([0.6, 0.8], np.float32), seen)
    assert (child, round(apart, 6)) == (3, 0.0)
    child, apart = most_alike_child(tree, 0, 0, 2, np.array([1.0, 0.0], np.float32), seen)
    assert (child, apart) == (1, 0.0)
