"""Define `Roadmap`, a network of proven free motions that is built once, for many queries in one scene.

A roadmap stores all motions that were tried, not only the free ones. When the scene changes, all motions are proven
again in one batch. In addition, the result of each query is proven as a whole. The second proof is necessary because
shifts by whole turns are rounded, the scene may have changed, and a file's claims are not a proof.
"""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _archives, _validate
from loewner._base._archives import Format
from loewner._base._guard import guarded
from loewner._base._read_only import KeepsReadOnly
from loewner._base._threads import in_shares
from loewner._base._validate import Bools, Floats, Ints
from loewner.errors import InputError, PlanningError
from loewner.planners import compiled
from loewner.planners.judge import Judge, checked_checker
from loewner.planners.pose_goals import PoseGoal
from loewner.planners.space import NAMED, Space, Task
from loewner.robots import CollisionChecker
from loewner.robots.checker import prepared_of

# Number of motions that are proven at a time, and number of nodes whose neighbours are sought at a time. Interrupts are
# noticed in between.
AT_A_TIME, NODES_AT_A_TIME = 16_384, 1024

# Largest number of motions that a query tries between the start, the goals and their nearest nodes.
MOST_TRIED = 4096

# Up to this number of configurations, a single thread seeks all neighbours.
ALONE = 64

# Largest number of bytes per motion while a roadmap is made: the motion's ends, its length, and its entries in the
# graph.
BYTES = 96


class _Links(NamedTuple):
    """Free motions between a query's ends and the nodes. The index of the start follows the index of the last node.

    Attributes
    ----------
    nodes, lengths : ndarray, shape (s,)
        The nodes to which motions from the start lead, and the motions' lengths.
    goals, from_nodes, to_lengths : ndarray, shape (g,)
        For each motion to a goal: the goal, the node at which the motion begins, and the motion's length.
    """

    nodes: Ints
    lengths: Floats
    goals: Ints
    from_nodes: Ints
    to_lengths: Floats

    def joined(self, more: _Links) -> _Links:
        """Concatenate these links and more links."""
        return _Links(*(np.concatenate(both) for both in zip(self, more, strict=True)))


@dataclass(frozen=True, eq=False)
class _Graph:
    """The free motions of a roadmap at one state of the scene.

    Attributes
    ----------
    version : int
        Version of the scene.
    proven : bool
        Whether this process proved the motions. If not, a file claims that they are free.
    free : ndarray of bool, shape (motions,)
    matrix : csr_array, shape (nodes, nodes)
        Lengths of the free motions, in both directions.
    labels : ndarray of int, shape (nodes,)
        Index of the connected component of each node.
    """

    version: int
    proven: bool
    free: Bools
    matrix: Any
    labels: Ints

    def shortest(self, links: _Links) -> tuple[Ints, int] | None:
        """Find the shortest path from the start to any goal, if there is one.

        Return the nodes of this path before the goal, and the index of the link to the goal.
        """
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        count, matrix = self.matrix.shape[0], self.matrix
        far, before = np.append(np.full(count, np.inf), 0.0), np.empty(0, dtype=np.int64)
        if len(links.nodes):
            lengths = np.concatenate([matrix.data, links.lengths])
            indices = np.concatenate([matrix.indices, links.nodes.astype(matrix.indices.dtype)])
            ends = np.append(matrix.indptr, matrix.nnz + len(links.nodes)).astype(matrix.indptr.dtype)
            with_start = csr_array((lengths, indices, ends), shape=(count + 1, count + 1))
            # If a straight motion to a goal is free, only shorter paths are sought.
            straight = float(links.to_lengths[links.from_nodes == count].min(initial=np.inf))
            far, before = dijkstra(with_start, indices=count, return_predecessors=True, limit=straight)
        totals = far[links.from_nodes] + links.to_lengths
        if not len(totals) or not np.isfinite(totals.min()):
            return None
        best = int(totals.argmin())
        numbers = [int(links.from_nodes[best])]
        while numbers[-1] != count:
            numbers.append(int(before[numbers[-1]]))
        return np.array(numbers[::-1]), best


@dataclass(frozen=True, eq=False)
class _Neighbours:
    """A search structure for nearest nodes.

    Attributes
    ----------
    space : Space
    count : int
        Number of nodes.
    tree : KDTree
        Tree over the values of the moving joints. The values of joints that turn without limits are periodic.
    """

    space: Space
    count: int
    tree: Any

    @classmethod
    def of(cls, space: Space, nodes: Floats) -> _Neighbours:
        """Prepare the search over the given nodes."""
        from scipy.spatial import KDTree

        box = np.where(space.turning, 2 * np.pi, 0.0) if space.turning.any() else None
        return cls(space, len(nodes), KDTree(cls._wrapped(space, nodes), boxsize=box))

    def of_all(self, Q: Floats, many: int) -> Ints:
        """Find the `many` nodes nearest to each configuration, sorted by distance, shape (N, many)."""
        return self._nearest(self._wrapped(self.space, Q), many)

    def pairs(self, neighbours: int) -> Ints:
        """Return a sorted list of all pairs of nodes where one node is among the other's nearest, shape (m, 2)."""
        each = min(neighbours, self.count - 1)
        if each == 0:
            return np.empty((0, 2), dtype=np.int64)
        what = f"a roadmap of {self.count} nodes with {each} neighbours each"
        _validate.fits_memory(self.count * each * BYTES, what)
        keys = []
        for first in range(0, self.count, NODES_AT_A_TIME):
            numbers = np.arange(first, min(first + NODES_AT_A_TIME, self.count))
            near = self._nearest(self.tree.data[numbers], each + 1)  # including the node itself
            pairs = np.sort([np.repeat(numbers, each + 1), near.ravel()], axis=0)
            keys.append((pairs[0] * self.count + pairs[1])[pairs[0] != pairs[1]])
        return np.stack(np.divmod(np.unique(np.concatenate(keys)), self.count), axis=1)

    def _nearest(self, values: Floats, many: int) -> Ints:
        neighbours = np.empty((len(values), many), dtype=np.int64)
        ranks = np.arange(1, many + 1)

        def share(first: int, last: int) -> None:
            neighbours[first:last] = self.tree.query(values[first:last], ranks)[1]

        # The tree's own threads would continue after an interrupt, and write to memory that has been freed.
        in_shares(share, len(values), ALONE)
        return neighbours

    @staticmethod
    def _wrapped(space: Space, Q: Floats) -> Floats:
        """Return the values of the moving joints, reduced to one turn for joints that turn without limits."""
        values: Floats = Q[:, space.columns]
        if space.turning.any():
            turned = np.mod(values[:, space.turning], 2 * np.pi)
            values[:, space.turning] = np.where(turned < 2 * np.pi, turned, 0.0)  # a value below 0 may round to a turn
        return values


@guarded
class Roadmap(KeepsReadOnly):
    """A network of configurations and proven free motions between them, for many queries. `roadmap` makes it.

    Notes
    -----
    A roadmap belongs to a single checker. After a change to the scene, the next query first proves all motions again in
    one batch, including motions that were not free before. `len` returns the number of nodes.

    Roadmaps are thread-safe. An interrupted call leaves the roadmap unchanged.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> made = roadmap(checker, 100)
    >>> made
    Roadmap(joints rail, elbow: 100 nodes, 1093 of 1093 motions free)
    >>> made.path([0.0, 1.57], [2.0, 1.57])
    array([[0.  , 1.57],
           [2.  , 1.57]])
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0.7], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> path = made.path([0.0, 1.57], [2.0, 1.57])  # the arm swings aside where it passes the post
    >>> len(path) > 2, checker.certify_edges(path[:-1], path[1:]).verdict.any()
    (True, np.False_)
    """

    def __init__(self, space: Space, nodes: Floats, edges: Ints, neighbours: int, seed: int) -> None:
        nodes.setflags(write=False)
        self._space, self._nodes, self._edges = space, nodes, edges
        self._neighbours, self._seed = neighbours, seed
        self._lengths = self._lengths_of(*nodes[edges.T])
        self._near = _Neighbours.of(space, nodes)
        self._graph: _Graph | None = None

    def __len__(self) -> int:
        return len(self._nodes)

    def __repr__(self) -> str:
        graph, total = self._graph, len(self._edges)
        motions = f"{total} motions, to be proven for the scene as it is now"
        if graph is not None and graph.version == self.checker.scene.version:
            motions = f"{int(graph.free.sum())} of {total} motions free"
        return f"Roadmap(joints {', '.join(self.joint_names)}: {len(self)} nodes, {motions})"

    @property
    def checker(self) -> CollisionChecker:
        """The checker to which the roadmap belongs. A different checker needs a different roadmap."""
        return self._space.checker

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints that move; all remaining joints have the same value in all `nodes`."""
        return tuple(self._space.name(column) for column in self._space.columns)

    @property
    def nodes(self) -> Floats:
        """The configurations, shape (n, dof), read-only. All of them were free when the roadmap was made."""
        return self._nodes

    @property
    def edges(self) -> Ints:
        """The motions that are free in the scene's current state, as pairs of indices into `nodes`, shape (m, 2)."""
        return self._edges[self._now().free]

    @property
    def components(self) -> Ints:
        """Number of nodes in each connected component, largest first. Nodes without free motions are not counted."""
        sizes = np.bincount(self._now().labels)
        return np.sort(sizes[sizes > 1])[::-1]

    def path(
        self, start: ArrayLike, goal: ArrayLike | PoseGoal, *, joint_error: ArrayLike = 0.0, simplify: bool = True
    ) -> Floats:
        """Find a path from start to goal, and prove that all motions of the path are free of collisions.

        Parameters
        ----------
        start : array_like, shape (dof,)
        goal : array_like, shape (dof,) or (goals, dof), or PoseGoal
            One goal or several, or poses of a link. The path leads to the goal that is nearest along the roadmap. Goals
            that are outside the limits or collide are ignored, as long as one goal remains.
        joint_error : float or array_like, shape (dof,)
            As for `plan`. A motion of the roadmap is proven for this error when a path needs the motion.
        simplify : bool
            Shorten the path, as `shorten` does.

        Returns
        -------
        ndarray, shape (k, dof)
            Configurations from `start` to a goal. Each joint value changes linearly from one configuration to the next.
            Between nodes, a joint that turns without limits takes the shorter direction, and may end at a value that
            differs from the goal's value by whole turns.

        Raises
        ------
        PlanningError
            If the start or all goals are outside the limits or collide. The message names joints, or pairs and depths.
            If no motion between the start or a goal and nearby nodes is free. If no component of the roadmap connects
            the start to a goal.
        InputError
            If an argument has the wrong shape or value. If the start or a goal differs from the nodes in a joint that
            does not move.
        UnknownNameError
            If the scene, since its last change, names a link that the robot does not have.

        Examples
        --------
        >>> from loewner import CollisionChecker, Robot
        >>> made = roadmap(CollisionChecker(Robot.from_urdf("arm.urdf")), 50, joints="rail")
        >>> made.path([0.0, 0.0], [2.0, 0.0])
        array([[0., 0.],
               [2., 0.]])
        """
        simplify = _validate.flag(simplify, "simplify")
        judge = Judge.of(self.checker, 0.0, joint_error)
        task = Task.of(self.checker, start, goal, self.joint_names)
        q, (begins, names, approaches) = task.start, task.goals(judge)
        # If a joint has no limits, the start and the goals determine the range of its values.
        space = Space.of_start(self.checker, self.joint_names, q, begins)
        if not space.outside(q):  # violations of limits are reported first
            self._space.check_still(q[None], "start", "the roadmap's value", "its joints")
        goals = space.checked_goals(q, begins, judge, names)
        while (judge_and_rows := self._found(judge, q, goals)) is None:
            pass  # the verdicts of the motions are outdated
        judge, rows = judge_and_rows
        if simplify:
            rows = compiled.shortened(judge, rows, max_iterations=compiled.CUTS, seed=self._seed)
        return rows if approaches is None else approaches.joined(judge, rows, space.unwound(rows[-1], begins))[0]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the roadmap to a file, marking the motions that are free in the scene's current state.

        Parameters
        ----------
        path : path
            The name of the file must end in ``.npz``. An existing file is replaced atomically.

        Raises
        ------
        InputError
            If `path` is not a path, or has another extension.
        FileError
            If the file cannot be written.

        Examples
        --------
        >>> from loewner import CollisionChecker, Robot
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
        >>> roadmap(checker, 100).save("arm.npz")
        >>> Roadmap.load("arm.npz", checker)
        Roadmap(joints rail, elbow: 100 nodes, 1093 of 1093 motions free)
        """
        graph, ready = self._now(), prepared_of(self.checker)
        arrays = {
            "nodes": self._nodes,
            "edges": self._edges,
            "free": graph.free.astype(np.int64),
            "settings": np.array([self._neighbours, self._seed]),
            "joints": np.array(self.joint_names),
            # If another thread has changed the scene in the meantime, the file has no fingerprint. After loading such a
            # file, all motions are proven again.
            "fingerprint": np.array(ready.fingerprint() if ready.version == graph.version else ""),
        }
        _archives.write(path, ROADMAPS, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str], checker: CollisionChecker) -> Roadmap:
        """Read a file written by `save`.

        Parameters
        ----------
        path : path
        checker : CollisionChecker
            A checker for a robot with the same joints.

        Returns
        -------
        Roadmap
            The roadmap, which belongs to `checker`. A verdict depends on the robot's joints and bodies, the checked
            pairs, margins, attachments, and the poses of the scene's bodies. If these are unchanged since the roadmap
            was saved, the search for a path relies on the motions that are marked as free in the file. Otherwise, the
            first query proves all motions again. The path itself is always proven.

        Raises
        ------
        FileError
            If the file does not exist, is damaged, is not a roadmap, or belongs to a robot with different joints or
            limits.
        InputError
            If an argument has the wrong type.
        UnknownNameError
            If the scene names a link that the robot does not have.

        Examples
        --------
        >>> from loewner import CollisionChecker, Robot
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> roadmap(CollisionChecker(robot), 100).save("arm.npz")
        >>> T = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]
        >>> Roadmap.load("arm.npz", CollisionChecker(robot.placed(T)))
        Roadmap(joints rail, elbow: 100 nodes, 1093 motions, to be proven for the scene as it is now)
        """
        ready = prepared_of(checked_checker(checker))  # errors in the scene must not be reported as errors in the file

        def made(told: dict[str, Any]) -> Roadmap:
            space, fingerprint = _checked(told, checker)
            loaded = cls(space, told["nodes"], told["edges"], *told["settings"].tolist())
            if fingerprint == ready.fingerprint():
                loaded._graph = loaded._graph_of(ready.version, told["free"] == 1, proven=False)
            return loaded

        return _archives.read(path, ROADMAPS, made)

    # -- which motions are free -----------------------------------------------------------------

    def _now(self) -> _Graph:
        """Return the graph for the scene's current state."""
        graph = self._graph
        if graph is not None and graph.version == prepared_of(self.checker).version:
            return graph
        return self._proven()

    @guarded
    def _proven(self) -> _Graph:
        """Prove all motions again and return the graph."""
        # The next query notices later changes.
        judge = Judge.of(self.checker, 0.0)
        sound = self._space.free_among(self._nodes)
        free = sound[self._edges[:, 0]] & sound[self._edges[:, 1]]
        at = np.flatnonzero(free)
        for first in range(0, len(at), AT_A_TIME):
            part = at[first : first + AT_A_TIME]
            a, b = self._nodes[self._edges[part].T]
            free[part] = judge.free(a, self._space.unwound(a, b))
        self._graph = graph = self._graph_of(judge.ready.version, free, proven=True)
        return graph

    def _graph_of(self, version: int, free: Bools, *, proven: bool) -> _Graph:
        """Make the graph over the nodes and the free motions between them."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import connected_components

        a, b = self._edges[free].T
        there_and_back = np.concatenate([a, b]), np.concatenate([b, a])
        matrix = csr_array((np.tile(self._lengths[free], 2), there_and_back), shape=(len(self), len(self)))
        return _Graph(version, proven, free, matrix, connected_components(matrix, directed=False)[1])

    # -- queries --------------------------------------------------------------------------------

    def _found(self, judge: Judge, q: Floats, goals: Floats) -> tuple[Judge, Floats] | None:
        """Find the shortest path over free motions, and prove it as a whole. Return None if the graph has changed."""
        full_graph = graph = self._now()
        links = self._links(graph, judge.now(), q, goals)
        while (way := graph.shortest(links)) is not None:
            nodes, last = way
            rows = np.concatenate([q[None], self._nodes[nodes[1:]], goals[links.goals[last]][None]])
            for k in range(1, len(rows)):
                rows[k] = self._space.unwound(rows[k - 1], rows[k])
            judge = judge.now()
            unfree = np.flatnonzero(~judge.free(rows[:-1], rows[1:]))
            if len(unfree) == 0:
                return judge, rows
            if not full_graph.proven:
                self._proven()
            if self._now() is not full_graph:
                return None
            graph, links = self._without(graph, links, nodes, last, unfree)
        raise PlanningError(
            "expected a path from start to goal that is free when it is proven as a whole, found none: all ways over "
            "the roadmap pass too near to a collision; more samples may help"
        )

    def _links(self, graph: _Graph, judge: Judge, q: Floats, goals: Floats) -> _Links:
        """Find free motions to the nearest nodes until they connect the start to a goal.

        Raises
        ------
        PlanningError
            If the start cannot be connected to a goal.
        """
        ends = np.concatenate([q[None], goals])
        most = min(len(self), max(self._neighbours, MOST_TRIED // len(ends)))
        links = self._straight(judge, q, goals)
        if links.to_lengths.min(initial=np.inf) == self._lengths_of(q, goals).min():
            return links  # no path is shorter than a straight motion to the nearest goal
        tried, last = 0, min(self._neighbours, most)
        labels = np.append(graph.labels, -1)  # -1 is the start, at which straight motions to goals begin
        while True:
            links = links.joined(self._links_to(judge, q, goals, self._near.of_all(ends, last)[:, tried:]))
            if np.isin(labels[links.from_nodes], np.append(labels[links.nodes], -1)).any():
                return links
            if last == most:
                raise PlanningError(_why(graph, links, most))
            tried, last = last, min(2 * last, most)

    def _straight(self, judge: Judge, q: Floats, goals: Floats) -> _Links:
        """Find the free straight motions from the start to goals."""
        free, lengths = self._judged(judge, np.broadcast_to(q, goals.shape), goals)
        at = np.flatnonzero(free)
        return _Links(at[:0], lengths[:0], at, np.full(len(at), len(self)), lengths[at])

    def _links_to(self, judge: Judge, q: Floats, goals: Floats, near: Ints) -> _Links:
        """Find free motions from the start to nodes (row 0 of `near`), and from nodes to goals (one row per goal)."""
        from_start, to_goals = near[0], near[1:].ravel()
        numbers, s = np.repeat(np.arange(len(goals)), near.shape[1]), len(from_start)
        a = np.concatenate([np.broadcast_to(q, (s, len(q))), self._nodes[to_goals]])
        free, lengths = self._judged(judge, a, np.concatenate([self._nodes[from_start], goals[numbers]]))
        here, there = free[:s], free[s:]
        return _Links(from_start[here], lengths[:s][here], numbers[there], to_goals[there], lengths[s:][there])

    def _judged(self, judge: Judge, a: Floats, b: Floats) -> tuple[Bools, Floats]:
        """Return which motions are free, and the lengths of all motions."""
        return judge.free(a, self._space.unwound(a, b)), self._lengths_of(a, b)

    def _without(self, graph: _Graph, links: _Links, nodes: Ints, last: int, unfree: Ints) -> tuple[_Graph, _Links]:
        """Remove motions of a path, given by indices along the path, from the graph and from the query's links."""
        from_start, to_goal = np.ones(len(links.nodes), dtype=bool), np.ones(len(links.goals), dtype=bool)
        free = graph.free.copy()
        keys = self._edges @ [len(self), 1]
        for k in unfree.tolist():
            if k == len(nodes) - 1:
                to_goal[last] = False
            elif k == 0:
                from_start &= links.nodes != nodes[1]
            else:
                pair = np.sort(nodes[k : k + 2])
                free[np.searchsorted(keys, pair @ [len(self), 1])] = False
        left = _Links(
            links.nodes[from_start], links.lengths[from_start],
            links.goals[to_goal], links.from_nodes[to_goal], links.to_lengths[to_goal],
        )  # fmt: skip
        return self._graph_of(graph.version, free, proven=True), left

    def _lengths_of(self, a: Floats, b: Floats) -> Floats:
        """Compute lengths of motions over the joints that move."""
        return np.asarray(np.linalg.norm((self._space.unwound(a, b) - a)[..., self._space.columns], axis=-1))


@guarded
def roadmap(
    checker: CollisionChecker,
    samples: int | ArrayLike,
    *,
    joints: str | Iterable[str] | None = None,
    fixed: ArrayLike | None = None,
    neighbours: int | None = None,
    seed: int = 0,
) -> Roadmap:
    """Make a roadmap for many queries, of free configurations and proven free motions between neighbours.

    Parameters
    ----------
    checker : CollisionChecker
        Bodies that are attached in the checker's scene move with the robot. If bodies come and go, make the roadmap
        while the scene contains few bodies, because configurations that collide at that time are excluded permanently.
    samples : int or array_like, shape (n, dof)
        The number of configurations to sample uniformly within the limits, or the configurations themselves. All free
        configurations become nodes.
    joints : str or iterable of str, optional
        A group, or names of joints. These joints move; all remaining joints keep their values. Default: all joints.
    fixed : array_like, shape (dof,), optional
        Values that the remaining joints keep. By default, these joints keep the values of the first configuration in
        `samples` or, if `samples` is a number, of `Robot.configuration`, which are all 0. The values of a joint that
        turns without limits are sampled within half a turn of its value in `fixed`.
    neighbours : int, optional
        Number of nearest neighbours to which each node is connected, if possible. Default: e (1 + 1/d) ln n for n nodes
        and d joints, as in PRM*. With this default, paths converge to shortest paths as the number of samples grows.
    seed : int
        Equal seeds lead to equal roadmaps and equal paths.

    Returns
    -------
    Roadmap

    Raises
    ------
    PlanningError
        If no sample is free.
    InputError
        If an argument has the wrong shape or value. If a given configuration is outside the limits, or differs from the
        other configurations in a joint that is not among `joints`. If one of `joints` is a planar, floating or ball
        joint, because such a joint has no limits for sampling.
    UnknownNameError
        If the robot has no such group or joint.

    See Also
    --------
    plan : For one query.

    References
    ----------
    Kavraki, Švestka, Latombe and Overmars (1996), "Probabilistic roadmaps for path planning in high-dimensional
    configuration spaces", doi:10.1109/70.508439. Karaman and Frazzoli (2011), "Sampling-based algorithms for optimal
    motion planning", doi:10.1177/0278364911406761.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> made = roadmap(CollisionChecker(Robot.from_urdf("arm.urdf")), 1000)
    >>> len(made), made.components
    (1000, array([1000]))
    """
    seed = _validate.whole_number(seed, "seed", 0, 2**32 - 2)
    if neighbours is not None:
        neighbours = _validate.whole_number(neighbours, "neighbours", 1)
    robot, count = checked_checker(checker).robot, _count(samples)
    kept = None if fixed is None else robot.checked_one(fixed, "fixed")
    if count is None:
        space, Q = _given(checker, samples, joints, kept)
    else:
        kept = robot.configuration() if kept is None else kept
        space = Space.of(checker, joints, kept, kept[None])
        _validate.fits_memory(3 * count * robot.dof * 8, f"{count} samples")
        values = np.random.default_rng(seed).uniform(space.lower, space.upper, (count, len(space.columns)))
        Q = space.configurations(values.clip(space.lower, space.upper))
    nodes = Q[space.free_among(Q)]
    if len(nodes) == 0:
        raise PlanningError(f"samples: expected some that are free, found none among {len(Q)}")
    if neighbours is None:
        neighbours = max(1, math.ceil(math.e * (1 + 1 / len(space.columns)) * math.log(len(nodes))))
    new_roadmap = Roadmap(space, nodes, _Neighbours.of(space, nodes).pairs(neighbours), neighbours, seed)
    new_roadmap._proven()
    return new_roadmap


def _given(
    checker: CollisionChecker, samples: Any, joints: str | Iterable[str] | None, kept: Floats | None
) -> tuple[Space, Floats]:
    """Check the configurations of a roadmap that the caller has chosen; return the space and the configurations."""
    configurations = checker.robot.checked(samples, "samples")
    if configurations.ndim != 2 or len(configurations) == 0:
        raise InputError(
            f"samples: expected a number of them, or configurations, shape (n, {checker.robot.dof}) with n >= 1, found "
            f"shape {_validate.shape_text(configurations.shape)}"
        )
    space = Space.of(checker, joints, configurations[0].copy() if kept is None else kept, configurations)
    _check_given(space, configurations, "samples")
    return space, configurations.copy()


def _count(samples: Any) -> int | None:
    """Return the number of samples to draw, or None if configurations seem to be given instead."""
    try:
        whole = not isinstance(samples, bool) and operator.index(samples) is not None
    except Exception:  # not an integer, or an error from the caller's object
        whole = False
    return _validate.whole_number(samples, "samples", 1) if whole else None


def _check_given(space: Space, Q: Floats, name: str) -> None:
    """Refuse given configurations that are outside the limits, or differ in joints that do not move."""
    inside = space.inside(Q)
    if not inside.all():
        k = int(inside.argmin())
        raise InputError(f"{name}[{k}]: expected a configuration within the limits, found {space.outside(Q[k])}")
    space.check_still(Q, f"{name}[{{}}]", "the value that all have", "the joints that move")


def _why(graph: _Graph, links: _Links, tried: int) -> str:
    """For an error message, explain why the start and the goals are not connected."""
    total = len(graph.labels)
    for name, linked_nodes in (("start", links.nodes), ("goal", links.from_nodes)):
        if len(linked_nodes) == 0:
            ways = "to it from" if name == "goal" else "from it to"
            return (
                f"{name}: expected a configuration that a free motion connects to the roadmap, found none {ways} the "
                f"nearest {tried} of {total} nodes; more samples, or some near it, may help"
            )
    sizes = np.bincount(graph.labels)
    of_start, of_goal = (
        ", ".join(str(size) for size in np.sort(sizes[np.unique(graph.labels[linked_nodes])])[::-1][:NAMED])
        for linked_nodes in (links.nodes, links.from_nodes)
    )
    return (
        "expected start and goal connected to one component of the roadmap, found the start connected to components "
        f"of size {of_start} and the goal to components of size {of_goal}, of {total} nodes in all; there may be no "
        "path; more samples, or `plan`, may help"
    )


# -- files ------------------------------------------------------------------------------------


def _check_shapes(shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse arrays whose shapes do not match, before the numbers of the arrays are read."""
    nodes, edges, free, settings = (shapes[name] for name in ROADMAPS.arrays)
    if len(nodes) != 2 or 0 in nodes:
        raise InputError(f"nodes: expected shape (n, dof), found {nodes}")
    if len(edges) != 2 or edges[1] != 2:
        raise InputError(f"edges: expected shape (m, 2), found {edges}")
    if free != edges[:1]:
        raise InputError(f"free: expected shape {edges[:1]}, found {free}")
    if settings != (2,):
        raise InputError(f"settings: expected shape (2,), found {settings}")


ROADMAPS = Format(
    "loewner-roadmap",
    1,
    what="a roadmap",
    else_use="loewner.planners.roadmap makes one",
    arrays=("nodes", "edges", "free", "settings"),
    integers=frozenset(("edges", "free", "settings")),
    check_shapes=_check_shapes,
    texts=("joints", "fingerprint"),
)


def _checked(told: dict[str, Any], checker: CollisionChecker) -> tuple[Space, str]:
    """Check the contents of a file; return its space and its fingerprint.

    Raises
    ------
    InputError
        If the file is not a roadmap, or is for a different robot.
    """
    robot, joints = checker.robot, told["joints"].ravel().tolist()
    robot_joints = [name for name in joints if name in robot.configuration_names and name in robot.joint_names]
    if not joints or robot_joints != joints or told["joints"].ndim != 1:
        raise InputError(f"expected a roadmap for joints of robot {robot.name!r}, found one for {', '.join(joints)}")
    nodes = told["nodes"] = robot.checked(told["nodes"], "nodes")
    space = Space.of(checker, joints, nodes[0], nodes)
    if [space.name(column) for column in space.columns] != joints:
        raise InputError(f"joints: expected those that move, in the order of the robot, found {', '.join(joints)}")
    _check_given(space, nodes, "nodes")
    (a, b), count = told["edges"].T, len(nodes)
    if not ((a >= 0) & (a < b) & (b < count)).all() or not (np.diff(a * count + b) > 0).all():
        raise InputError(f"edges: expected pairs of two of {count} nodes, ascending, found others")
    if not np.isin(told["free"], (0, 1)).all():
        raise InputError("free: expected 0 or 1, found other numbers")
    neighbours, seed = told["settings"].tolist()
    if neighbours < 1 or seed not in range(2**32 - 1):
        raise InputError(f"settings: expected a number of neighbours and a seed, found {neighbours} and {seed}")
    return space, str(told["fingerprint"])
