"""A search tree as a picture: text in Graphviz's language, for `dot -Tsvg` or any viewer of it.

Boxes are histories with their visits, edges actions with their mean return and visits, and what was observed: whether
the search ever asked, and what it made of the answers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skd_adversary.planning.search_tree import CHILDREN, FIRST_CHILD, VALUE, VISITS, SearchTree


def tree_as_dot(
    tree: SearchTree, *, actions: Sequence[str] | None = None, depth: int = 2, least_visits: int = 1, digits: int = 1
) -> str:
    """Return the top of a tree in the DOT language.

    Args:
        tree: the search tree, as `planner.tree` returns it.
        actions: names of the actions; by default their numbers.
        depth: number of steps to show.
        least_visits: least number of visits of histories that are shown; an action is shown if it was tried.
        digits: number of digits behind the point, for observations and values.

    Raises:
        ValueError: there are not as many names as actions.
    """
    count = tree.statistics.shape[1]
    names = [str(action) for action in range(count)] if actions is None else list(actions)
    if len(names) != count:
        raise ValueError(f"the tree has {count} actions, got {len(names)} names")
    lines = ["digraph tree {", "  rankdir=LR; node [shape=box];", f'  n0 [label="{tree.total[0]} visits"];']

    def add(node: int, left: int) -> None:
        for action in range(count):
            visits = tree.statistics[node, action, VISITS]
            if visits <= 0 or left == 0:
                continue
            value = f"{tree.statistics[node, action, VALUE]:.{digits}f}"
            arm = f"n{node}a{action}"
            lines.append(f'  {arm} [shape=plaintext label="{names[action]}: {value}\\n{int(visits)} visits"];')
            lines.append(f"  n{node} -> {arm};")
            child = int(tree.links[node, action, FIRST_CHILD])
            for _ in range(tree.links[node, action, CHILDREN]):
                if tree.total[child] >= least_visits:
                    seen = ", ".join(f"{x:.{digits}f}" for x in np.asarray(tree.observation[child], float))
                    lines.append(f'  n{child} [label="{tree.total[child]} visits"];')
                    lines.append(f'  {arm} -> n{child} [label="{seen}"];')
                    add(child, left - 1)
                child = int(tree.sibling[child])

    add(0, depth)
    return "\n".join([*lines, "}", ""])
