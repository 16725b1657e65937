"""The kernel that lists pairs and lays out tables, against references that are written as the definitions."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from checker_oracle import random_robot
from families import translation
from loewner import Body, CollisionChecker, Scene
from loewner._kernels import columns, tolerances
from loewner._kernels.robots import pair_lists
from loewner._native import entries


def listed(things, moving, marks, own, least, rules):
    """Pairs and margins by their definition."""
    found = {}
    for a, b in itertools.combinations(range(len(own)), 2):
        of_robot = marks[a][0], marks[b][0]
        margins = [own[a][0], own[b][0], own[a][1] * of_robot[1], own[b][1] * of_robot[0]]
        lowered = marks[a][1] or marks[b][1] or (marks[a][2] and of_robot[1]) or (marks[b][2] and of_robot[0])
        is_checked, margin = True, max(*margins, 0.0 if lowered else least[int(all(of_robot))])
        for one, other, touch, overrides, ruled in rules:
            if {one, other} == {a, b}:
                is_checked = is_checked if touch < 0 else touch == 0
                margin = margin if ruled < 0 else ruled if overrides else max(ruled, margin)
        if is_checked and a < moving and not (b < moving and things[a] == things[b]):
            found[a, b] = margin
    return found


@pytest.mark.parametrize("seed", range(20))
def test_pairs_follow_the_rules(seed):
    """The pairs and margins of random rules, some of which are about absent or static bodies, are as by definition."""
    rng = np.random.default_rng(seed)
    bodies, links = int(rng.integers(1, 9)), 5
    moving, count = int(rng.integers(0, bodies + 1)), int(rng.integers(0, 30))
    parent, kind = np.arange(links) - 1, rng.choice([columns.FIXED, columns.REVOLUTE], links)
    link = rng.integers(0, links, moving)
    marks, own = rng.integers(0, 2, (bodies, 3)), rng.integers(0, 5, (bodies, 2)) / 8
    least, rule_margins = rng.integers(0, 5, 2) / 8, rng.integers(-1, 5, count) / 8
    rules = np.column_stack(
        [rng.integers(-1, bodies, (count, 2)), rng.integers(-1, 2, count), rng.integers(0, 2, count)]
    )
    different = rules[:, 0] != rules[:, 1]
    rules, rule_margins = rules[different], rule_margins[different]
    most = moving * (2 * bodies - moving - 1) // 2
    pairs, margins = np.empty((most, 2), dtype=np.int64), np.empty(most)
    found = entries.list_pairs(parent, kind, link, marks, own, least, rules, rule_margins, pairs, margins)
    things = np.where(kind[link] == columns.FIXED, parent[link], link)
    expected = listed(
        things, moving, marks, own, least, [(*rule, m) for rule, m in zip(rules, rule_margins, strict=True)]
    )
    assert dict(zip(map(tuple, pairs[:found].tolist()), margins[:found].tolist(), strict=True)) == expected
    assert list(map(tuple, pairs[:found].tolist())) == sorted(expected)


def test_paths_orders_and_chains_are_as_defined(rng, tmp_path):
    """Paths lead from the world to each link; proofs begin far out; chains bound lengths and bends from above."""
    T = np.eye(4)
    T[0, 2] = T[2, 0] = 4e-7
    robot, scene = random_robot(rng, tmp_path, 9, [Body.sphere(0.05), Body.box([0.1, 0.2, 0.05])]).placed(T), Scene()
    for k in range(9):
        scene.add(f"ball{k}", Body.sphere(0.02), translation(0.4, 0.1 * k, 0.2))
    ready = CollisionChecker(robot, scene)._ready()
    tree, tables = ready.robot.tree, ready.tables
    paths, lengths = [], []
    for link, (above, kind) in enumerate(zip(tree.parent.tolist(), tree.kind.tolist(), strict=True)):
        paths.append((paths[above] if above >= 0 else []) + [link] * (kind != columns.FIXED))
        own = np.linalg.norm(tree.constants[link, columns.TRANSLATION : columns.TRANSLATION + 3])
        lengths.append(own + (lengths[above] if above >= 0 else 0.0))
    assert [part.tolist() for part in np.split(tables.path_link, tables.path_start[1:-1])] == paths
    depths = np.array(list(map(len, paths)))[ready.link]
    np.testing.assert_array_equal(tables.order, np.argsort(-depths[ready.pairs[:, 0]], kind="stable"))
    reach = [ready.packs[k].kernel.table[:, columns.REACH].max() + lengths[link] for k, link in enumerate(ready.link)]
    assert tables.chain[0] == 1 + depths.max()
    assert tables.chain[1] == pytest.approx(max(reach) * tolerances.CHAIN_STRETCH, rel=1e-14)
    fixed, sine, cosine = (tree.constants[:, None, k : k + 9] for k in (columns.ROTATION, columns.SINE, columns.COSINE))
    turns = np.isin(tree.kind, (columns.REVOLUTE, columns.PLANAR))[:, None, None]
    angles = np.arange(8)[:, None] * np.pi / 4
    R = (fixed + turns * (np.sin(angles) * sine + np.cos(angles) * cosine)).reshape(len(tree.kind), 8, 3, 3)
    departures = np.linalg.norm(R.swapaxes(2, 3) @ R - np.eye(3), axis=(2, 3))
    assert tables.chain[2] == pytest.approx(2 * departures.max(axis=1).sum(), rel=1e-6)


def test_a_chain_of_moving_joints_alone_has_an_order():
    """If no link is fixed to the world, the last one has as many joints before it as there are links."""
    problem = SimpleNamespace(pairs=np.array([[0, 2], [1, 2]]), link=np.array([0, 1]))
    tables = SimpleNamespace(order=np.full(2, -1))
    pair_lists._write_order.py_func(np.array([1, 2]), problem, tables)
    assert tables.order.tolist() == [1, 0]
