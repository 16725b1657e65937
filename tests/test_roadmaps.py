"""Roadmaps: nets of proven motions, asked many times, kept in files, and proven anew when the scene changes."""

import dataclasses
import io
import pickle
import shutil
import signal
import threading
import zipfile

import numpy as np
import pytest
from scipy.spatial import KDTree

import loewner
from families import translation
from gantry import IN_WALL, LEFT, RADIUS, RIGHT, UP
from loewner import (
    Body,
    CollisionChecker,
    FileError,
    InputError,
    PlanningError,
    Robot,
    Scene,
    UnknownNameError,
    Verdict,
    planners,
)
from loewner._base import _archives
from loewner.planners import roadmaps
from loewner.planners.judge import TOLERANCE, Judge


def wall(top=0.5):
    """A wall along y, 0.1 m thick, that ends at `top`."""
    return translation(y=top - 2.0)


def walled():
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), wall())
    return scene


@pytest.fixture
def scene():
    return walled()


@pytest.fixture
def made(checker):
    return planners.roadmap(checker, 400, joints="slide", fixed=LEFT)


def proven(checker, path):
    """Whether all motions of a path are proven free."""
    return (checker.certify_edges(path[:-1], path[1:], tolerance=TOLERANCE).verdict == Verdict.FREE).all()


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


# -- what a roadmap is --------------------------------------------------------------------------


def test_nodes_and_motions_are_free(made, checker):
    """Nodes are within the limits and free, motions are pairs of nodes in ascending order, each proven."""
    assert len(made) == len(made.nodes) < 400
    assert (np.abs(made.nodes[:, :2]) <= 1).all()
    assert (made.nodes[:, 2] == UP).all()
    assert not checker.collide(made.nodes).any()
    a, b = made.edges.T
    assert (a < b).all()
    assert (np.diff(a * len(made) + b) > 0).all()
    assert (checker.certify_edges(made.nodes[a], made.nodes[b]).verdict == Verdict.FREE).all()
    assert made.checker is checker
    assert made.joint_names == ("x", "y")


def test_motions_lead_to_the_nearest_nodes(checker):
    """By brute force: every pair of which one is among the other's k nearest is kept, if it is free; no other."""
    made = planners.roadmap(checker, 150, joints="slide", fixed=LEFT, neighbours=4)
    far = np.linalg.norm(made.nodes[:, None] - made.nodes[None], axis=2)
    np.fill_diagonal(far, np.inf)
    nearest = np.argsort(far, axis=1)[:, :4]
    pairs = {(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row}
    free = {(i, j) for i, j in sorted(pairs) if proven(checker, made.nodes[[i, j]])}
    assert free == set(map(tuple, made.edges.tolist()))
    assert len(free) < len(pairs)


def test_number_of_neighbours_is_that_of_prm_star(checker):
    """e (1 + 1/d) ln n, rounded up, for the n samples that are free."""
    made = planners.roadmap(checker, 300, joints="slide", fixed=LEFT)
    assert made._neighbours == int(np.ceil(np.e * 1.5 * np.log(len(made))))


def test_joints_without_limits_wrap(robot):
    """Neighbours across half a turn are neighbours, and a path goes the short way around."""
    checker = CollisionChecker(robot)
    turns = np.linspace(-np.pi, np.pi, 40, endpoint=False)
    Q = np.column_stack([np.zeros((40, 2)), turns])
    made = planners.roadmap(checker, Q, joints="turn", neighbours=2)
    assert [0, 39] in made.edges.tolist()
    assert made.components.tolist() == [40]
    start, goal = np.array([0, 0, 3.0]), np.array([0, 0, -3.0 - 8 * np.pi])
    path = made.path(start, goal, simplify=False)
    np.testing.assert_array_equal(path[0], start)
    assert path[-1, 2] == pytest.approx(2 * np.pi - 3.0)
    assert length(path) == pytest.approx(2 * np.pi - 6.0)


def test_paths_over_joints_that_wrap(robot):
    """A post keeps the rod from turning past 0: from one side of it to the other the path leads through half a turn."""
    scene = Scene()
    scene.add("post", Body.sphere(0.05), translation(0.3))
    checker = CollisionChecker(robot, scene)
    made = planners.roadmap(checker, 60, joints="turn", fixed=[0.0, 0.0, 7 * np.pi], neighbours=2)
    for start, goal in ((0.5, -0.5), (0.5 + 6 * np.pi, -0.5 - 8 * np.pi), (-0.5, 0.5)):
        a, b = np.array([[0.0, 0.0, start], [0.0, 0.0, goal]])
        path = made.path(a, b)
        np.testing.assert_array_equal(path[0], a)
        assert np.cos(path[-1, 2]) == pytest.approx(np.cos(0.5), abs=1e-9)
        assert np.sin(path[-1, 2]) == pytest.approx(np.sin(goal), abs=1e-9)
        assert length(path) == pytest.approx(2 * np.pi - 1.0, abs=1e-6)
        assert proven(checker, path)


def test_samples_that_are_given(checker):
    """Those that are free become the nodes, in their order; what does not move is what they have."""
    Q = np.array([LEFT, IN_WALL, [-0.5, 0.8, UP], [0.5, 0.8, UP], RIGHT])
    made = planners.roadmap(checker, Q, joints="slide")
    np.testing.assert_array_equal(made.nodes, Q[[0, 2, 3, 4]])
    assert made.edges.tolist() == [[0, 1], [1, 2], [2, 3]]
    np.testing.assert_array_equal(made.path(LEFT, RIGHT, simplify=False)[[0, -1]], [LEFT, RIGHT])
    alone = planners.roadmap(checker, Q[:1], joints="slide")
    assert (len(alone), len(alone.edges), len(alone.components)) == (1, 0, 0)
    np.testing.assert_array_equal(alone.path([-0.4, 0, UP], [-0.4, 0.1, UP]), [[-0.4, 0, UP], [-0.4, 0.1, UP]])


def test_equal_seeds_give_equal_roadmaps(checker):
    """Nodes, motions and paths are the same for equal seeds; other seeds give others."""
    one, same, other = (planners.roadmap(checker, 200, joints="slide", fixed=LEFT, seed=s) for s in (3, 3, 4))
    for name in ("nodes", "edges"):
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
    np.testing.assert_array_equal(one.path(LEFT, RIGHT), same.path(LEFT, RIGHT))
    assert one.nodes.shape != other.nodes.shape or (one.nodes != other.nodes).any()


# -- paths --------------------------------------------------------------------------------------


@pytest.mark.parametrize("simplify", [False, True])
def test_paths_go_around_the_wall(made, checker, simplify):
    """Paths keep their ends and the joints that stay, are proven, and no shorter than the shortest way."""
    path = made.path(LEFT, RIGHT, simplify=simplify)
    np.testing.assert_array_equal(path[[0, -1]], [LEFT, RIGHT])
    assert (path[:, 2] == UP).all()
    assert proven(checker, path)
    assert length(path) >= 2 * np.hypot(0.45, 1.0) + 0.1 - 1e-9  # past the wall's two corners, at least
    assert length(path) < 3.0


def test_paths_of_random_queries(made, checker, rng):
    """Every path that is returned is proven, starts and ends where it should, and simplified ones are no longer."""
    Q = np.column_stack([rng.uniform(-1, 1, (60, 2)), np.full(60, UP)])
    Q = Q[~checker.collide(Q)]
    Q = Q[: len(Q) // 2 * 2].reshape(-1, 2, 3)
    assert len(Q) > 10
    for start, goal in Q:
        long, short = (made.path(start, goal, simplify=s) for s in (False, True))
        for path in (long, short):
            np.testing.assert_array_equal(path[[0, -1]], [start, goal])
            assert proven(checker, path)
        assert length(short) <= length(long) + 1e-9


def test_paths_are_the_shortest_over_the_roadmap(made):
    """From node to node, by brute force: no way over the motions (or the straight one) is shorter."""
    count = len(made)
    far = np.full((count, count), np.inf)
    a, b = made.edges.T
    far[a, b] = far[b, a] = np.linalg.norm(made.nodes[a] - made.nodes[b], axis=1)
    np.fill_diagonal(far, 0.0)
    for k in range(count):  # Floyd and Warshall
        far = np.minimum(far, far[:, k, None] + far[k])
    for i, j in ((0, 5), (1, 17), (30, 100), (7, 250)):
        found = length(made.path(made.nodes[i], made.nodes[j], simplify=False))
        assert found <= far[i, j] * (1 + 1e-9)
        assert found >= np.linalg.norm(made.nodes[i] - made.nodes[j]) * (1 - 1e-9)


def test_any_of_several_goals(made):
    """Goals in the wall or outside are passed over; of the others the nearest by way of the roadmap is reached."""
    near = np.array([-0.5, 0.0, UP])
    path = made.path(LEFT, [IN_WALL, [1.5, 0, UP], RIGHT, near])
    np.testing.assert_array_equal(path, [LEFT, near])
    np.testing.assert_array_equal(made.path(LEFT, [IN_WALL, RIGHT])[-1], RIGHT)


def test_start_is_the_goal_and_a_node(made):
    """From a node to itself the path stays there, and has two rows."""
    node = made.nodes[3]
    np.testing.assert_array_equal(made.path(node, node), [node, node])


def test_more_nodes_are_tried_where_the_nearest_do_not_do(robot):
    """A start in a narrow slot sees only nodes that are far away: they are found."""
    scene = Scene()
    for x in (-0.12, 0.12):
        scene.add(f"side {x}", Body.box([0.02, 0.6, 1.0]), translation(x))
    checker = CollisionChecker(robot, scene)
    Q = np.array([[x, y, UP] for x in np.linspace(0.25, 0.6, 12) for y in np.linspace(-0.2, 0.2, 9)])
    made = planners.roadmap(checker, [*Q, [0.0, 0.6, UP], [0.6, 0.6, UP]], joints="slide", neighbours=8)
    path = made.path([0.0, 0.0, UP], [0.6, 0.0, UP])
    assert proven(checker, path)


# -- the scene changes --------------------------------------------------------------------------


def test_changed_scenes_are_noticed(made, checker, scene):
    """Opened, the straight way is free; closed, there is none; put back, all is as it was."""
    before, edges = made.path(LEFT, RIGHT), made.edges
    scene.move("wall", wall(-0.8))
    assert "to be proven" in repr(made)
    np.testing.assert_array_equal(made.path(LEFT, RIGHT), [LEFT, RIGHT])
    assert len(made.edges) > len(edges)
    assert "motions free" in repr(made)
    scene.move("wall", wall(1.5))
    with pytest.raises(PlanningError, match=r"one component .* start connected to components of size \d+ and the goal"):
        made.path(LEFT, RIGHT)
    assert len(made.components) >= 2
    scene.move("wall", wall())
    np.testing.assert_array_equal(made.edges, edges)
    np.testing.assert_array_equal(made.path(LEFT, RIGHT), before)
    scene.set_margin(0.2)
    path = made.path(LEFT, RIGHT)
    assert proven(checker, path)
    assert path[:, 1].max() >= 0.5 + RADIUS + 0.2


def test_a_change_in_the_middle_of_a_query(made, checker, scene, monkeypatch):
    """The wall rises after motions were looked up: what is returned is proven for the scene as it came to be."""
    found = made._links

    def and_then(*arguments):
        links = found(*arguments)
        scene.move("wall", wall(0.7))
        return links

    monkeypatch.setattr(made, "_links", and_then)
    path = made.path(LEFT, RIGHT)
    assert proven(checker, path)
    assert path[:, 1].max() >= 0.7
    monkeypatch.setattr(made, "_links", found)
    scene.move("wall", wall())

    def closed(*arguments):
        links = found(*arguments)
        scene.move("wall", wall(1.5))
        return links

    monkeypatch.setattr(made, "_links", closed)
    with pytest.raises(PlanningError, match="one component"):
        made.path(LEFT, RIGHT)


def test_interrupts_leave_it_whole(made, scene, monkeypatch):
    """An interrupt while all is proven anew leaves the old state, and the next query proves all again."""
    before = made.path(LEFT, RIGHT)
    scene.move("wall", wall(0.3))
    scene.move("wall", wall())

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Judge, "free", interrupted)
        with pytest.raises(KeyboardInterrupt):
            made.path(LEFT, RIGHT)
    assert "to be proven" in repr(made)
    np.testing.assert_array_equal(made.path(LEFT, RIGHT), before)


def test_what_cannot_be_settled_is_not_free(checker, undecided):
    """Samples without a proof are left out."""
    doubtful = np.array([-0.5, 0.8, UP])
    undecided(checker, lambda Q: (doubtful == Q).all(axis=1))
    made = planners.roadmap(checker, [LEFT, doubtful, RIGHT], joints="slide")
    np.testing.assert_array_equal(made.nodes, [LEFT, RIGHT])


def test_copies_travel(made):
    """A pickled roadmap, with its checker, gives the same paths."""
    again = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(again.path(LEFT, RIGHT), made.path(LEFT, RIGHT))
    again.checker.scene.move("wall", wall(1.5))
    with pytest.raises(PlanningError):
        again.path(LEFT, RIGHT)
    made.path(LEFT, RIGHT)


# -- no path ------------------------------------------------------------------------------------


def test_start_and_goal_are_looked_at(made):
    """Limits come first, then collisions with pairs and depths, as for `plan`."""
    with pytest.raises(PlanningError, match=r"start: .* x = -1\.5 outside -1 \.\. 1"):
        made.path([-1.5, 0.0, UP], IN_WALL)
    with pytest.raises(PlanningError, match="start: .* collision of ball and wall .* deep"):
        made.path(IN_WALL, RIGHT)
    with pytest.raises(PlanningError, match="goal: .* collision of ball and wall"):
        made.path(LEFT, IN_WALL)
    with pytest.raises(PlanningError, match=r"goal: .* found none: goal\[0\]: x = 2 outside .*goal\[1\]: y = 3"):
        made.path(LEFT, [[2, 0, UP], [0, 3, UP]])
    with pytest.raises(PlanningError, match=r"start: .* x = 2 outside"):
        made.path([2.0, 0.0, 0.0], RIGHT)


def test_start_and_goal_that_cannot_be_connected(checker, scene):
    """A start or goal in a cell of its own is told, with how many nodes were tried."""
    made = planners.roadmap(checker, [RIGHT, [0.5, 0.5, UP], [0.5, 0.8, UP], [-0.5, 0.8, UP]], joints="slide")
    for k, (x, y, width, height) in enumerate(
        [(-0.72, -0.5, 0.04, 0.5), (-0.28, -0.5, 0.04, 0.5), (-0.5, -0.72, 0.5, 0.04), (-0.5, 0.0, 0.5, 0.04)]
    ):
        scene.add(f"side {k}", Body.box([width, height, 1.0]), translation(x, y))
    cell = np.array([-0.5, -0.5, UP])
    assert not checker.collide(cell)
    with pytest.raises(PlanningError, match="start: .*found none from it to the nearest 4 of 4 nodes"):
        made.path(cell, RIGHT)
    with pytest.raises(PlanningError, match="goal: .*found none to it from the nearest"):
        made.path(RIGHT, cell)


def test_no_free_sample(checker):
    """A roadmap without nodes is none."""
    with pytest.raises(PlanningError, match="samples: expected some that are free, found none among 1"):
        planners.roadmap(checker, [IN_WALL], joints="slide")


# -- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("samples", "options", "error", "message"),
    [
        (0, {}, InputError, "samples: expected an integer >= 1, found 0"),
        (10**400, {}, InputError, "samples: expected an integer <="),
        (2**62, {}, InputError, "fit into memory"),
        (2.5, {}, InputError, r"samples: expected shape \(\.\.\., 3\)"),
        ("many", {}, InputError, "samples: expected numbers, found 'many'"),
        (True, {}, InputError, "samples: expected real numbers, found dtype bool"),
        ([0.1, 0.2, 0.3], {}, InputError, r"samples: .* shape \(n, 3\) with n >= 1, found shape \(3,\)"),
        (np.empty((0, 3)), {}, InputError, r"samples: .* found shape \(0, 3\)"),
        ([LEFT, [3, 0, UP]], {}, InputError, r"samples\[1\]: .*x = 3 outside -1 \.\. 1"),
        (
            [LEFT, [0.5, 0.5, 0]],
            {"joints": "slide"},
            InputError,
            r"samples\[1\]: expected .* 1\.57.*, of turn,.* found 0",
        ),
        (
            [LEFT],
            {"joints": "slide", "fixed": [0, 0, 0]},
            InputError,
            r"samples\[0\]: expected .* 0, of turn",
        ),
        (9, {"joints": "slid"}, UnknownNameError, "did you mean 'slide'"),
        (9, {"joints": []}, InputError, "joints: expected one or more, found none"),
        (9, {"fixed": [0, 0]}, InputError, r"fixed: expected shape \(\.\.\., 3\)"),
        (9, {"neighbours": 0}, InputError, "neighbours: expected an integer >= 1, found 0"),
        (9, {"neighbours": 2.5}, InputError, "neighbours: expected an integer"),
        (9, {"seed": -1}, InputError, "seed: expected an integer >= 0"),
        (9, {"seed": 2**40}, InputError, "seed: expected an integer <="),
    ],
)
def test_bad_arguments(checker, samples, options, error, message):
    """Every bad argument is refused by its name, with what was expected."""
    with pytest.raises(error, match=message):
        planners.roadmap(checker, samples, **options)


def test_bad_queries(made, robot):
    """Wrong shapes, flags and joints that stay are refused by name."""
    with pytest.raises(InputError, match=r"start: expected one configuration, shape \(3,\)"):
        made.path([LEFT], RIGHT)
    with pytest.raises(InputError, match=r"goal: expected shape \(3,\) or \(goals, 3\), found \(0, 3\)"):
        made.path(LEFT, np.zeros((0, 3)))
    with pytest.raises(InputError, match="simplify: expected True or False"):
        made.path(LEFT, RIGHT, simplify=1)
    with pytest.raises(InputError, match=r"goal: expected the start's value, 1\.57.*, of turn.* found 0"):
        made.path(LEFT, [0.5, -0.5, 0.0])
    with pytest.raises(InputError, match=r"start: expected the roadmap's value, 1\.57.*, of turn.* found 0"):
        made.path([-0.5, -0.5, 0.0], [0.5, -0.5, 0.0])
    with pytest.raises(InputError, match="checker: expected loewner.CollisionChecker, found Robot"):
        planners.roadmap(robot, 9)


# -- files --------------------------------------------------------------------------------------


def arrays(path):
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def forge(path, told, **changes):
    """Write a file whose checksum is right, whatever is in it."""
    content = {name: array for name, array in told.items() if name not in ("format", "version", "digest")}
    content |= {name: np.asarray(value) for name, value in changes.items()}
    with open(path, "wb") as stream:
        np.savez(stream, format=told["format"], version=told["version"], digest=_archives.digest(content), **content)


@pytest.fixture(scope="module")
def first(robot, tmp_path_factory):
    """A file of the roadmap, which is made once for all tests of files."""
    path = tmp_path_factory.mktemp("roadmap") / "map.npz"
    planners.roadmap(CollisionChecker(robot, walled()), 400, joints="slide", fixed=LEFT).save(path)
    return path


@pytest.fixture
def saved(first, tmp_path):
    return shutil.copy(first, tmp_path / "map.npz")


def test_saved_and_loaded_are_equal(made, robot, saved, monkeypatch):
    """Nodes, motions and paths come back; for an equal checker nothing is proven anew but the path."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), wall())
    proofs = []
    monkeypatch.setattr(planners.Roadmap, "_proven", lambda self: proofs.append(self))
    loaded = planners.Roadmap.load(saved, CollisionChecker(robot, scene))
    assert repr(loaded) == repr(made)
    for name in ("nodes", "edges", "components"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(made, name))
    for simplify in (False, True):
        np.testing.assert_array_equal(
            loaded.path(LEFT, RIGHT, simplify=simplify), made.path(LEFT, RIGHT, simplify=simplify)
        )
    assert not proofs


def test_saved_again_is_the_same(made, checker, saved, tmp_path):
    """What is loaded and saved again says the same."""
    planners.Roadmap.load(saved, checker).save(tmp_path / "again.npz")
    first, second = arrays(saved), arrays(tmp_path / "again.npz")
    assert first.keys() == second.keys()
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name])


def _moved(robot, scene):
    scene.move("wall", wall(0.49))
    return robot


def _margin(robot, scene):
    scene.set_margin(0.01)
    return robot


def _another_body(robot, scene):
    scene.remove("wall")
    scene.add("wall", Body.box([0.11, 4.0, 1.0]), wall())
    return robot


def _allowed(robot, scene):
    scene.allow("rod", "wall")
    return robot


def _attached(robot, scene):
    scene.add("can", Body.sphere(0.02), translation(5.0))
    scene.attach("can", "ball", translation(0.0, 0.1), touch_links=["rod"])
    return robot


def _placed(robot, scene):
    return robot.placed(translation(0.1))


@pytest.mark.parametrize("change", [_moved, _margin, _another_body, _allowed, _attached, _placed])
def test_whatever_verdicts_depend_on_is_compared(made, robot, scene, saved, change):
    """If any of it differs, all motions are proven anew when they are first asked about, and paths are right."""
    checker = CollisionChecker(change(robot, scene), scene)
    loaded = planners.Roadmap.load(saved, checker)
    assert "to be proven" in repr(loaded)
    a, b = loaded.edges.T
    assert (checker.certify_edges(loaded.nodes[a], loaded.nodes[b]).verdict == Verdict.FREE).all()
    assert proven(checker, loaded.path(LEFT, RIGHT))


def test_forged_motions_are_found_out(made, checker, saved):
    """A file that calls all motions free makes no path that is not: all are proven anew once one is found wanting."""
    told = arrays(saved)
    assert not told["free"].all()
    forge(saved, told, free=np.ones_like(told["free"]))
    loaded = planners.Roadmap.load(saved, checker)
    assert len(loaded.edges) > len(made.edges)
    np.testing.assert_array_equal(loaded.path(LEFT, RIGHT), made.path(LEFT, RIGHT))
    np.testing.assert_array_equal(loaded.edges, made.edges)


def test_what_fails_as_a_whole_is_passed_by(made, checker, saved, monkeypatch):
    """Motions that are found not to be free on a path are left out of the query, one path after the other."""
    told = arrays(saved)
    forge(saved, told, free=np.ones_like(told["free"]))
    loaded = planners.Roadmap.load(saved, checker)
    loaded._graph = dataclasses.replace(loaded._graph, proven=True)
    np.testing.assert_array_equal(loaded.path(LEFT, RIGHT, simplify=False), made.path(LEFT, RIGHT, simplify=False))
    once = iter([True])
    monkeypatch.setattr(Judge, "free", lambda self, a, b: np.full(len(a), next(once, False)))
    with pytest.raises(PlanningError, match="when it is proven as a whole"):
        made.path(LEFT, RIGHT)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("nodes", np.zeros((3, 2)), r"nodes: expected shape \(\.\.\., 3\)"),
        ("nodes", np.zeros((0, 3)), r"nodes: expected shape \(n, dof\), found \(0, 3\)"),
        ("nodes", np.zeros(3), r"nodes: expected shape \(n, dof\), found \(3,\)"),
        ("nodes", np.zeros((400, 3), dtype=np.float32), "nodes: expected float64, found float32"),
        ("nodes", np.full((400, 3), np.nan), "nodes.*: expected finite numbers, found nan"),
        ("nodes", np.full((400, 3), 1.5), r"nodes\[0\]: expected a configuration within the limits, found x = 1\.5"),
        ("nodes", np.diag([0.0, 0, 1]), r"nodes\[2\]: expected the value that all have, 0, of turn"),
        ("nodes", np.full((4, 3), UP), "nodes|edges"),
        ("edges", [[0, 1], [0, 1]], r"free: expected shape \(2,\)"),
        ("edges", np.zeros((3, 3), dtype=int), r"edges: expected shape \(m, 2\), found \(3, 3\)"),
        ("edges", 0.5, "edges: expected int64, found float64"),
        ("free", [1], "free: expected shape"),
        ("settings", [5], r"settings: expected shape \(2,\), found \(1,\)"),
        ("settings", [0, 0], "settings: expected a number of neighbours and a seed, found 0 and 0"),
        ("settings", [5, -1], "settings: expected .*found 5 and -1"),
        ("joints", ["x", "z"], "expected a roadmap for joints of robot 'gantry', found one for x, z"),
        ("joints", ["y", "x"], "joints: expected those that move, in the order of the robot, found y, x"),
        ("joints", ["x", "x"], "joints: expected those that move, in the order of the robot, found x, x"),
        ("joints", "x", "expected a roadmap for joints of robot 'gantry'"),
        ("joints", 3, "expected short text, found int64"),
        ("fingerprint", 3, "expected short text, found int64"),
        ("extra", 3, "expected one array of each name, found 'extra.npy'"),
    ],
)
def test_forged_files_are_refused(checker, saved, name, value, message):
    """Whatever is not as `save` writes it is refused, and the message names file and array."""
    forge(saved, arrays(saved), **{name: value})
    with pytest.raises(FileError, match=rf"map\.npz: .*({message})"):
        planners.Roadmap.load(saved, checker)


@pytest.mark.parametrize("pair", [(-1, 1), (1, 1), (2, 1), (0, 400), (2**62, 2**62 + 1)])
def test_forged_pairs_are_refused(checker, saved, pair):
    """Pairs of nodes that are none."""
    told = arrays(saved)
    told["edges"][0] = pair
    forge(saved, told)
    with pytest.raises(FileError, match=r"map\.npz: edges: expected pairs of two of \d+ nodes, ascending"):
        planners.Roadmap.load(saved, checker)
    told["edges"][0] = told["edges"][1]
    forge(saved, told)
    with pytest.raises(FileError, match="edges: expected pairs"):
        planners.Roadmap.load(saved, checker)


def test_damaged_files_are_refused(checker, saved, tmp_path):
    """Cut short, a byte changed, of another kind, a body, missing: each a FileError."""
    whole = saved.read_bytes()
    for damaged in (whole[:-100], whole[:50], b"", b"x" * 1000):
        saved.write_bytes(damaged)
        with pytest.raises(FileError, match=r"map\.npz"):
            planners.Roadmap.load(saved, checker)
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["nodes.npy"] = members["nodes.npy"][:-1] + b"@"
    with zipfile.ZipFile(saved, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    with pytest.raises(FileError, match="does not match its checksum"):
        planners.Roadmap.load(saved, checker)
    Body.sphere(1.0).save(tmp_path / "body.npz")
    with pytest.raises(FileError, match="found another kind"):
        planners.Roadmap.load(tmp_path / "body.npz", checker)
    with pytest.raises(FileError, match="expected a saved file, but there is no such file"):
        planners.Roadmap.load(tmp_path / "none.npz", checker)


def test_bad_arguments_of_files(made, robot, checker, saved, tmp_path, scene):
    """Paths that are none, a checker that is none, and a scene that names a link the robot lacks."""
    with pytest.raises(InputError, match=r"path: expected a name that ends in \.npz, found 'map\.txt'"):
        made.save(tmp_path / "map.txt")
    for ask in (made.save, lambda path: planners.Roadmap.load(path, checker)):
        with pytest.raises(InputError, match="path: expected a path, found NoneType"):
            ask(None)
    with pytest.raises(InputError, match="checker: expected loewner.CollisionChecker, found Robot"):
        planners.Roadmap.load(saved, robot)
    scene.allow("wall", "hand")
    with pytest.raises(UnknownNameError, match="expected one of .*found 'hand'"):
        planners.Roadmap.load(saved, checker)


def test_the_old_file_or_the_new_one(made, saved, monkeypatch):
    """An interrupt while a file is written leaves the old one, and nothing else."""
    before = saved.read_bytes()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        made.save(saved)
    assert saved.read_bytes() == before
    assert sorted(entry.suffix for entry in saved.parent.iterdir()) == [".npz"]


def test_a_scene_that_changes_while_it_is_saved(made, checker, scene, tmp_path, monkeypatch):
    """What is saved then belongs to no scene, and is proven anew when it is loaded."""
    graph = made._now()
    scene.move("wall", wall(0.3))
    monkeypatch.setattr(made, "_now", lambda: graph)
    made.save(tmp_path / "map.npz")
    assert "to be proven" in repr(planners.Roadmap.load(tmp_path / "map.npz", checker))


def test_motions_are_proven_in_parts(made, scene, monkeypatch):
    """However many at a time, the same motions are free."""
    edges = made.edges
    scene.move("wall", wall())
    monkeypatch.setattr(roadmaps, "AT_A_TIME", 7)
    np.testing.assert_array_equal(made.edges, edges)


def test_motions_too_long_to_prove_are_not_free(tmp_path):
    """Slides of kilometres and many turns at once: no motion of the roadmap, and no error about its number."""
    joints = "".join(
        f"""<link name="l{k}"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
        <joint name="j{k}" type="{kind}"><parent link="{f"l{k - 1}" if k else "world"}"/><child link="l{k}"/>
        <origin xyz="0.5 0 0"/><axis xyz="{axis}"/><limit lower="-{far}" upper="{far}"/></joint>"""
        for k, (kind, axis, far) in enumerate(
            [("revolute", "0 0 1", 100), ("revolute", "0 0 1", 100), ("prismatic", "1 0 0", 9e5)]
        )
    )
    (tmp_path / "far.urdf").write_text(f'<robot name="far"><link name="world"/>{joints}</robot>')
    scene = Scene()
    scene.add("box", Body.box([1, 1, 1]), translation(5.0))
    with pytest.warns(UserWarning, match=r"limits in radians, found -100 \.\. 100"):
        robot = Robot.from_urdf(tmp_path / "far.urdf")
    made = planners.roadmap(CollisionChecker(robot, scene), 10)
    assert len(made.edges) < len(made._edges)


def test_an_interrupt_leaves_no_thread_that_writes(made):
    """Nobody goes on searching for neighbours, in memory that was given back, once an interrupt has ended the call."""
    values = np.random.default_rng(0).random((20_000, 30))
    near = dataclasses.replace(made._near, count=len(values), tree=KDTree(values))
    threads = loewner.get_num_threads()
    loewner.set_num_threads(2)
    near._nearest(values[:100], 2)  # starts the threads that stay
    before, handler = set(threading.enumerate()), signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012  # the timer may go off at once
            signal.setitimer(signal.ITIMER_REAL, 0.02)
            near._nearest(values[:2000], 20)
        assert set(threading.enumerate()) <= before
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, handler)
        loewner.set_num_threads(threads)
