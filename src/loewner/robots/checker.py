"""Check a robot in a scene, at one configuration, at millions of configurations, or along motions.

A `CollisionChecker` checks arguments, keeps the prepared pairs (see `problem`) until the scene changes, and wraps the
results of `verdicts`, `proofs` and `distances`. Only this module raises an error for an unsettled answer.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._matrices import lengths
from loewner._base._pictures import LINKS, bodies, pictured
from loewner._base._plausible import warn
from loewner._base._validate import Bools, Floats, OneOrMany, Pair
from loewner._kernels import codes
from loewner.bodies import Body, packed_of, reach_of
from loewner.errors import ConvergenceError, InputError
from loewner.queries.pairs import VERDICTS, Verdict, collide
from loewner.robots.checking import cells, distances, edges, pair_cache, self_filter, verdicts
from loewner.robots.checking.checked_pairs import prepared
from loewner.robots.checking.distances import PairDistances, StateDistance
from loewner.robots.checking.problem import Problem
from loewner.robots.checking.verdicts import Settled, Verdicts
from loewner.robots.description.robot import Robot
from loewner.robots.description.robot import drawn as drawn_robot
from loewner.robots.proofs import approaches, contact_times, curves, in_time, proofs, tracking
from loewner.robots.proofs.courses import straight
from loewner.robots.proofs.curves import CertifiedTrajectory
from loewner.robots.proofs.motions import CertifiedMotions
from loewner.robots.proofs.proof_models import model_of
from loewner.robots.proofs.written_proofs import proof_of
from loewner.scenes.scene import Contact, Scene, poses_since
from loewner.scenes.scene import drawn as drawn_scene

# Number of configurations after which the pairs are first reordered. They are reordered again each time the number of
# checked configurations has doubled.
FIRST_LOOK = 32

# A pair is suspected of always colliding only if it also collides in this number of random configurations.
SUSPECTED = 64

# A scene is probably in millimetres if all of its bodies are farther away than FAR times the robot's reach. The reach
# is estimated from TRIED random configurations.
FAR, TRIED = 100.0, 8

# Version of the scene, queries for one configuration, and the prepared pairs. They form one tuple, since replacing a
# tuple is thread-safe and fast.
UNPREPARED: tuple[int, Any, Any] = (-1, None, None)


@guarded
class CollisionChecker:
    """Check configurations of a robot for collisions with itself and with a scene.

    Parameters
    ----------
    robot : Robot
    scene : Scene, optional
        The scene may be changed afterwards; the next query uses its new state. By default only the robot is checked.
    allowed : iterable of pairs of str, optional
        Pairs of links that may touch, in addition to the robot's `disabled_pairs`; for instance the keys of the dict
        that `pairs_by_sampling` returns.
    skip_adjacent : bool, optional
        Skip pairs of links that are connected by a joint, since most such links overlap by design. By default, these
        pairs are skipped only if the robot has no disabled pairs or rules for pairs, as an SRDF or an MJCF file gives.

    Raises
    ------
    InputError
        If the robot has no collision geometry, since every configuration would be free.
    UnknownNameError
        If a link in `allowed` does not belong to the robot.

    Notes
    -----
    The checker tests all pairs of links that can move relative to each other, and all links and attached bodies against
    all bodies of the scene, except for allowed pairs. Rigidly joined bodies are never checked against each other.
    Bodies of the scene are not checked against each other either: use `Scene.pairs`.

    The scene's margin applies to pairs with a body of the scene. A pair of links has a margin only if
    `Scene.set_margin` sets a margin for all links, for one of the two links, or for the pair (see `Scene.margin_of`).

    If no pair is checked (for example, because all pairs are allowed), every configuration is free: see
    `checked_pairs`.

    Several threads may use a checker at the same time, even while other threads change its scene. Each answer refers to
    one consistent state of the scene.

    Examples
    --------
    >>> from loewner import Body
    >>> scene = Scene(margin=0.01)
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> checker = CollisionChecker(robot, scene)
    >>> checker.collide([[0.0, 1.57], [1.0, 1.57]])  # the cart next to the post, and inside it
    array([False,  True])
    >>> [(contact.name_a, contact.name_b) for contact in checker.pairs([1.0, 1.57])]
    [('cart', 'post')]
    >>> checker.collide(robot.random_configurations(10_000)).shape
    (10000,)
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        allowed: Iterable[Pair] = (),
        skip_adjacent: bool | None = None,
    ) -> None:
        _validate.instance(robot, "robot", Robot)
        if scene is not None and not isinstance(scene, Scene):
            raise InputError(f"scene: expected loewner.Scene or None, found {type(scene).__name__}")
        if all(map(_is_empty, robot.bodies.values())):
            raise InputError(
                f"robot: expected a robot with collision geometry, found none in {robot.name!r}; "
                f"links with <visual> only: {', '.join(robot._only_visual) or 'none'}"
            )
        self._robot = robot
        self._scene = Scene() if scene is None else scene
        skip_adjacent = None if skip_adjacent is None else _validate.flag(skip_adjacent, "skip_adjacent")
        skipped = robot._usually_skipped if skip_adjacent is None else robot.disabled_pairs
        if skip_adjacent:
            skipped |= robot.adjacent_pairs
        self._skipped = skipped | robot.link_pairs(allowed, "allowed")
        _warn_of_refuted(robot)
        self._prepared = UNPREPARED
        self._still: tuple[int, CollisionChecker] | None = None  # scene's version, and result of `without_motions`
        self._seen, self._next_look, self._suspected = 0, FIRST_LOOK, False
        self._is_near = False  # whether the distances of the scene's bodies have been checked

    def __getstate__(self) -> dict[str, Any]:
        """Leave the prepared pairs out of copies and pickles: their handle is an address, valid only in this object."""
        return {**self.__dict__, "_prepared": UNPREPARED, "_still": None}

    def __repr__(self) -> str:
        return f"CollisionChecker({self.robot!r}, {self.scene!r})"

    @pictured
    def _repr_html_(self) -> str:
        links, poses, note = drawn_robot(self.robot)
        held = {name: poses[one.link] @ one.T_link_body for name, one in self.scene.attachments.items()}
        shapes, entries, more = drawn_scene(self.scene, held)
        return bodies(links + shapes, (), [(self.robot.name, LINKS[0]), *entries], note + more)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the robot and the scene's present state in a file that C and C++ programs read with ``loewner.h``.

        Parameters
        ----------
        path : path
            A path that ends in ``.lwn``. An existing file is replaced only after the new file has been written under a
            temporary name.

        Raises
        ------
        InputError
            If the name does not end in ``.lwn``. If bodies of the scene follow motions or have inexact poses.
        UnknownNameError
            As for `collide`.
        FileError
            If the file cannot be written.

        Notes
        -----
        The file contains prepared data, which only the same version of loewner can read. In programs that read the
        file, contacts at the ends of motions count as collisions even if `Scene.leave` or `Scene.reach` permits them.
        To set errors of poses, such a program calls ``loewner_checker_set_bounds``.

        Examples
        --------
        >>> CollisionChecker(Robot.from_urdf("arm.urdf")).save("arm.lwn")
        """
        ready, scene = self._ready(timed=True), self._scene.snapshot()
        while ready.version != scene.version:  # another thread changed the scene in between
            ready, scene = self._ready(timed=True), self._scene.snapshot()
        cells.save(path, self.robot, scene, ready)

    # -- queries ------------------------------------------------------------------------------

    # Read-only: with another robot or scene, the prepared arrays would silently give wrong answers.
    @property
    def robot(self) -> Robot:
        """The robot that is checked. A different robot, or a different pose of its base, needs a new checker."""
        return self._robot

    @property
    def scene(self) -> Scene:
        """The scene in which the robot is checked. The scene may be changed; a different scene needs a new checker."""
        return self._scene

    @property
    def checked_pairs(self) -> tuple[Pair, ...]:
        """Names of the pairs that are checked."""
        ready = self._ready(timed=True)
        return tuple((ready.names[a], ready.names[b]) for a, b in ready.pairs)

    @property
    def model_hash(self) -> str:
        """SHA-256 of the model, that is, of the robot and the scene's present state: see `Proof.model_hash`.

        Equal hashes mean that links, joints, shapes, poses, pairs and margins are equal to the last bit. An InputError
        is raised if proofs cannot express the robot or the scene.
        """
        return model_of(self._ready(timed=True)).hash

    def collide(self, Q: ArrayLike, t: ArrayLike | None = None) -> OneOrMany:
        """Decide exactly which configurations are in collision.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
            Entries in the order of `Robot.configuration_names`. Limits are not enforced: see `Robot.lower`.
        t : float or array_like, shape (...), optional
            Times in seconds, broadcast with the configurations; required if bodies of the scene follow motions.

        Returns
        -------
        bool, or ndarray of bool, shape (...)
            True if the robot collides. Touching, or coming within the margin, counts as colliding.

        Raises
        ------
        InputError
            If the width of Q is not dof, or an entry is not finite. If there are more than 2^24 pairs to check. If
            bodies of the scene follow motions (`Scene.follow`) and no time is given.
        UnknownNameError
            If an attachment, an allowed pair or a margin of the scene names a link that the robot does not have.
        ConvergenceError
            If a configuration could not be settled. An unsettled configuration never counts as free.

        Warns
        -----
        UserWarning
            Once per robot, if a configuration is far outside the limits: see `Robot.checked`.
        """
        version, single, ready = self._prepared
        if t is None:
            if version != self._scene.version:
                ready = self._ready()
                single = ready.single
            collides = single.collide(Q)
            if collides is not None:
                self._seen += 1  # inline, since a call of `_learn` would take a tenth of the time
                if self._seen >= self._next_look:
                    self._learn(ready, 0)
                return collides
            checked = self.robot.checked(Q)
        else:
            checked, ready, times = self._at(Q, t)
            if times is not None and ready.paths is not None and ready.paths.bounds:
                free = in_time.free_at(ready, edges.flat(checked), times)
                return bool(not free[0]) if checked.ndim == 1 else ~free.reshape(checked.shape[:-1])
        return verdicts.collisions(self._exact(ready, checked).verdicts, checked)

    def classify(self, Q: ArrayLike, t: ArrayLike | None = None) -> OneOrMany:
        """Compute certified verdicts from the ellipsoids alone.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        t : float or array_like, shape (...), optional
            As for `collide`.

        Returns
        -------
        Verdict, or ndarray of int8, shape (...)
            FREE if every pair is proven free, COLLIDING if any pair is proven colliding, else AMBIGUOUS.

        Raises
        ------
        InputError, UnknownNameError
            As for `collide`.
        """
        version, single, ready = self._prepared
        if version == self._scene.version and t is None and ready.given is None:
            verdict = single.classify(Q)
            if verdict is not None:
                self._learn(ready, 1)
                return VERDICTS[verdict]
        checked, ready, times = self._at(Q, t)
        rows = edges.flat(checked)
        out, _ = verdicts.classified(ready, codes.CERTIFY, rows)
        self._learn(ready, len(out))
        out = self._doubted(ready, rows, times, out)
        return Verdict(int(out[0])) if checked.ndim == 1 else out.reshape(checked.shape[:-1])

    def tiers(self, Q: ArrayLike) -> Settled:
        """Count how many configurations each kind of test settles when all configurations are decided exactly.

        Parameters
        ----------
        Q : array_like, shape (..., dof)

        Returns
        -------
        Settled
        """
        return self.settle(Q)[1]

    def settle(self, Q: ArrayLike) -> tuple[OneOrMany, Settled]:
        """Return the results of `collide` and of `tiers` from one computation.

        Parameters
        ----------
        Q : array_like, shape (..., dof)

        Returns
        -------
        collides : bool, or ndarray of bool, shape (...)
        settled : Settled

        Raises
        ------
        InputError, UnknownNameError, ConvergenceError
            As for `collide`.
        """
        checked, ready, _ = self._at(Q, None)
        answers = self._exact(ready, checked)
        return verdicts.collisions(answers.verdicts, checked), answers.counted()

    def valid_edges(self, Q0: ArrayLike, Q1: ArrayLike, resolution: float) -> OneOrMany:
        """Decide which straight motions are free of collisions, from samples at most `resolution` apart.

        Parameters
        ----------
        Q0, Q1 : array_like, shape (..., dof)
            Ends of the motions, broadcast together.
        resolution : float
            Largest Euclidean distance between two successive checked configurations, in the units of the joints.

        Returns
        -------
        bool, or ndarray of bool, shape (...)
            True if both ends and all samples between them are free. Collisions between samples are not detected.

        Notes
        -----
        Joint values change linearly, and quaternions follow the shorter arc. A motion is checked at its ends, then at
        its middle, then at its quarters, since collisions tend to be found early in this order.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> checker.valid_edges([0.0, 1.57], [[0.5, 1.57], [2.0, 1.57]], resolution=0.05)  # the post is in the way
        array([ True, False])
        """
        version, single, ready = self._prepared
        if version == self._scene.version:
            settled = single.motion(Q0, Q1, resolution, edges.coarse_first)
            if settled is not None:
                self._seen += abs(settled)
                if self._seen >= self._next_look:
                    self._learn(ready, 0)
                return settled > 0
        step = _validate.positive_scalar(resolution, "resolution")
        a, b, shape = edges.ends(self.robot, Q0, Q1)
        ready = self._ready()
        edge_verdicts, fractions = verdicts.sampled(ready, a, b, step)
        for k in np.flatnonzero(edge_verdicts == codes.AMBIGUOUS)[:1]:
            verdicts.expect_settled(ready, self.robot.between(a[k], b[k], fractions[k])[None], edge_verdicts[k : k + 1])
        valid = np.asarray(edge_verdicts == codes.FREE)
        return valid.reshape(shape) if shape else bool(valid[0])

    def certify_edges(
        self,
        Q0: ArrayLike,
        Q1: ArrayLike,
        *,
        tolerance: float = 1e-5,
        joint_error: ArrayLike = 0.0,
        t0: ArrayLike | None = None,
        t1: ArrayLike | None = None,
        steps: int | None = None,
        proof: bool = False,
    ) -> CertifiedMotions:
        """Prove which straight motions are free of collisions along their whole length.

        Parameters
        ----------
        Q0, Q1 : array_like, shape (..., dof)
            Ends of the motions, broadcast together.
        tolerance : float
            Distance in metres. A motion that comes within this distance of colliding may be AMBIGUOUS; every other
            motion is FREE or COLLIDING.
        joint_error : float or array_like, shape (dof,)
            Radians or metres by which each value may deviate from the motion; FREE covers all such deviations. A motion
            that collides only for deviating values is AMBIGUOUS. With a joint error, contact at the ends is not
            allowed.
        t0, t1 : float or array_like, shape (...), optional
            Times in seconds at which the motions begin and end, broadcast with the motions; required if bodies of the
            scene follow motions (`Scene.follow`). A motion reaches its fraction f at time t0 + f (t1 - t0).
        steps : int, optional
            Maximum number of steps spent on each motion. A step places a configuration, compares two bodies or pieces,
            runs a search, or opens a box of a tree. A motion that needs more steps is AMBIGUOUS, with the fraction and
            the pair at which its proof stopped. docs/certified.md, "Bounded work", gives the time of a step. Default:
            no limit.
        proof : bool
            If all motions are free, also write a `Proof`, with the motions in the order of the flattened batch. Such a
            proof requires that all joints turn or slide, and that no bodies follow motions. The proof states where
            bodies are in contact at the ends of motions (`Scene.leave`, `Scene.reach`), and how deeply they may overlap
            there. Successive motions without gaps count as one curve, with a single bound on the depth.

        Returns
        -------
        CertifiedMotions

        Raises
        ------
        InputError
            If the width of Q0 or Q1 is not dof, an entry is not finite, or the shapes do not broadcast. If the
            tolerance is not positive and finite, a joint error is negative, or `steps` is not an integer >= 1. If a
            motion is so long that it would take more than 458,752 intervals. If bodies of the scene follow motions and
            a time is missing, or t1 is before t0. If a proof is requested and proofs cannot express the robot or the
            scene.
        UnknownNameError
            As for `collide`.
        ConvergenceError
            If the motions are free, but a proof cannot be written. There are three possible reasons: the proof's bound
            on the effect of joint errors is too coarse, a pair comes within a few micrometres of its margin, or the
            planes of a contact do not suffice. The message names the pair.

        See Also
        --------
        valid_edges : Checks samples of the motion only.
        joint_error : Finds the largest joint error that is proven.

        Notes
        -----
        Joint values change linearly, and orientations turn at a constant rate along the shorter arc, as in
        `Robot.between`. The proof takes no samples: a plane that separates two bodies is a proof for a whole interval
        of the motion, and an interval without such a plane is halved. docs/certified.md gives the derivation. For
        surfaces and clouds, the proof uses the convex hulls of a few parts. Where such a hull meets a convex piece or a
        hull of the other body, the proof uses the triangles or points of the parts. The first call with a new surface
        takes longer, since it computes the parts.

        Pairs named by `Scene.leave` may be in contact at the start of a motion, and pairs named by `Scene.reach` at its
        end. Along the motion, a contact at the start may become deeper by at most the tolerance. A contact at the end
        may be no deeper than the tolerance. Both bounds also hold for bodies that follow motions.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> found = checker.certify_edges([0.0, 1.57], [[0.5, 1.57], [2.0, 1.57]])  # the post is in the way
        >>> found.verdict, found.names[1].tolist()
        (array([0, 1], dtype=int8), ['cart', 'post'])
        >>> checker.collide(checker.robot.between([0.0, 1.57], [2.0, 1.57], found.fraction[1]))
        True
        """
        tolerance = _validate.positive_scalar(tolerance, "tolerance")
        most = None if steps is None else _validate.whole_number(steps, "steps", 1, codes.NO_LIMIT)
        a, b, shape = edges.ends(self.robot, Q0, Q1)
        errors, times = curves.joint_errors(self.robot, joint_error), _begin_and_end(t0, t1)
        options = proofs.ProofOptions(tolerance, errors, most)
        ready = self._ready(timed=times is not None)
        model = model_of(ready) if _validate.flag(proof, "proof") else None
        if times is not None:
            whole = _validate.broadcast({"motions": shape, "t0, t1": times[0].shape})
            a, b = (edges.flat(np.broadcast_to(Q.reshape(*shape, Q.shape[1]), (*whole, Q.shape[1]))) for Q in (a, b))
            shape, times = whole, (np.broadcast_to(times[0], whole).ravel(), np.broadcast_to(times[1], whole).ravel())
        if times is None or ready.paths is None:
            answers = proofs.prove_by_rules(ready, a, b, options)
        else:
            answers = in_time.prove_edges(self.robot, ready, ready.paths, (a, b), times, options)
        answers.expect_short(a, b)
        motions = answers.of_shape(shape, ready)
        if model is None or not (answers.verdicts == codes.FREE).all():
            return motions
        deeper = None if errors.any() else tolerance
        return replace(motions, proof=proof_of(model, ready, straight(ready.robot, a, b), errors, deeper))

    @overload
    def certify_trajectory(
        self, curve: list[Any] | tuple[Any, ...], *, tolerance: float = ..., joint_error: ArrayLike = ...,
        t0: float | None = ..., steps: int | None = ..., proof: bool = ...,
    ) -> tuple[CertifiedTrajectory, ...]: ...  # fmt: skip
    @overload
    def certify_trajectory(
        self, curve: Any, *, tolerance: float = ..., joint_error: ArrayLike = ...,
        t0: float | None = ..., steps: int | None = ..., proof: bool = ...,
    ) -> CertifiedTrajectory: ...  # fmt: skip
    def certify_trajectory(
        self,
        curve: Any,
        *,
        tolerance: float = 1e-5,
        joint_error: ArrayLike = 0.0,
        t0: float | None = None,
        steps: int | None = None,
        proof: bool = False,
    ) -> CertifiedTrajectory | tuple[CertifiedTrajectory, ...]:
        """Prove that a curve executed by a robot is free of collisions at every instant.

        Bodies of the scene that follow motions (`Scene.follow`) move at the same times.

        Parameters
        ----------
        curve : PPoly, BPoly, BSpline, planners.Trajectory, ControllerPoints or Drive, or a list of curves
            A continuous piecewise polynomial of time, of degree at most 7, with values of shape (dof,). Subclasses of
            SciPy's types, such as ``CubicSpline(times, path)``, are accepted. The columns are in the order of
            `Robot.configuration_names`, unless the curve itself names its columns. Quaternions are scaled to norm 1.
        tolerance : float
            Distance in metres, as for `certify_edges`.
        joint_error : float or array_like, shape (dof,)
            Radians or metres by which each value may deviate from the curve; FREE covers all such deviations. With a
            joint error, contact at the ends is not allowed.
        t0 : float, optional
            Offset in seconds that is added to the curve's times, for example the time at which a trajectory that begins
            at 0 is started. The offset matters only for bodies that follow motions; the times in the result include it.
            Default: the `start_time` of a `planners.Trajectory` or of `planners.ControllerPoints`, and 0 for other
            curves.
        steps : int, optional
            Maximum number of steps spent on each curve, as for `certify_edges`. The segments of a curve share this
            limit: when it is used up, the remaining segments are AMBIGUOUS.
        proof : bool
            Also write a `Proof` of each free curve, as for `certify_edges`.

        Returns
        -------
        CertifiedTrajectory
            One result, or a tuple of results for a list of curves.

        Raises
        ------
        InputError
            If the curve has the wrong type, does not match the robot's joints, or is not continuous. If its degree is
            above 7, a number is not finite, or its times do not increase. If the values of a SciPy curve differ from
            the values that its coefficients define. If a proof is requested, also as for `certify_edges`.
        ConvergenceError
            As for `certify_edges`.

        Notes
        -----
        For each pair, each polynomial piece is divided into intervals, and on each interval a plane separates the two
        bodies. The proof uses bounds on the first and second derivatives; docs/certified.md derives these bounds.

        Pairs named by `Scene.leave` may be in contact where the curve begins, and pairs named by `Scene.reach` where it
        ends, as for `certify_edges`. The ends of individual segments do not count as ends of the curve. A segment is
        FREE if it is proven free, except for the contact that these rules allow. With a joint error, contact is not
        allowed.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> from scipy.interpolate import CubicSpline
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> path = [[0.0, 1.57], [1.0, 1.57], [2.0, 1.57]]
        >>> found = checker.certify_trajectory(CubicSpline([0.0, 1.0, 2.0], path))
        >>> print(found.verdict, found.names)
        COLLIDING ('cart', 'post')
        """
        tolerance = _validate.positive_scalar(tolerance, "tolerance")
        errors = curves.joint_errors(self.robot, joint_error)
        ready = self._ready(timed=True)
        model = model_of(ready) if _validate.flag(proof, "proof") else None
        most = None if steps is None else _validate.whole_number(steps, "steps", 1, codes.NO_LIMIT)
        checked_curves = curves.curves_of(self.robot, self.scene, curve, t0)
        options = proofs.ProofOptions(tolerance, errors, most)
        trajectories = curves.certified(self.robot, ready, checked_curves, options, model)
        return tuple(trajectories) if isinstance(curve, (list, tuple)) else trajectories[0]

    joint_error = tracking.joint_error
    first_contact = contact_times.first_contact
    closest = approaches.closest
    off_the_robot = self_filter.off_the_robot

    def pairs(self, q: ArrayLike, t: float | None = None) -> tuple[Contact, ...]:
        """Name the pairs that touch, overlap or come within their margin at one configuration.

        Parameters
        ----------
        q : array_like, shape (dof,)
        t : float, optional
            As for `collide`.

        Returns
        -------
        tuple of Contact
            One entry per pair, with its exact distance or depth, witness points and normal.
        """
        time = None if t is None else _validate.finite_array(t, "t", ())
        checked, ready, _ = self._at(self.robot.checked_one(q), time)
        contacts, doubt = verdicts.contacts(ready, checked, None if time is None else float(time))
        if doubt:
            raise ConvergenceError(doubt)
        return contacts

    def collide_by_pair(self, Q: ArrayLike, t: ArrayLike | None = None) -> Bools:
        """Decide exactly which pairs collide at each configuration; `collide` is faster if the pairs do not matter.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        t : float or array_like, shape (...), optional
            As for `collide`.

        Returns
        -------
        ndarray of bool, shape (..., pairs)
            Pairs in the order of `checked_pairs`.

        Raises
        ------
        InputError, UnknownNameError, ConvergenceError
            As for `collide`.
        """
        checked, ready, times = self._at(Q, t)
        collisions = verdicts.collisions_by_pair(ready, edges.flat(checked), times)
        return collisions.reshape(*checked.shape[:-1], len(ready.pairs))

    @overload
    def distance(
        self, Q: ArrayLike, t: ArrayLike | None = ..., *, exact: Literal[False] = ..., gradient: Literal[False] = ...
    ) -> StateDistance[None, None]: ...
    @overload
    def distance(
        self, Q: ArrayLike, t: ArrayLike | None = ..., *, exact: Literal[True], gradient: bool = ...
    ) -> StateDistance[OneOrMany, Floats]: ...
    @overload
    def distance(
        self, Q: ArrayLike, t: ArrayLike | None = ..., *, exact: bool, gradient: bool = ...
    ) -> StateDistance: ...
    def distance(
        self, Q: ArrayLike, t: ArrayLike | None = None, *, exact: bool = False, gradient: bool = False
    ) -> StateDistance:
        """Bound the distance of the nearest pair and, on request, compute it exactly; margins are ignored.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        t : float or array_like, shape (...), optional
            As for `collide`.
        exact : bool
            Also compute the exact distance or depth, with its pair, witnesses and normal.
        gradient : bool
            Also compute the derivative of the exact distance with respect to the configuration, in metres per radian or
            metre.

        Returns
        -------
        StateDistance
            Distances in metres and names of bodies, as single values for one configuration and as arrays for a batch.

        Raises
        ------
        InputError
            As for `collide`; also if there is no pair to check, or a gradient is requested without the exact distance.
        ConvergenceError
            As for `loewner.distance`.

        Notes
        -----
        The gradient is n · (J_b x_b - J_a x_a), with the normal n from a to b and the Jacobians J of the witnesses,
        regarded as points fixed to their links. If the nearest pair or its witnesses are not unique (two pairs tie, or
        faces or edges are parallel), the distance has a kink. The gradient is then the derivative for one of the
        choices. The derivative with respect to a quaternion accounts only for the rotation that the quaternion
        represents, so its component along the quaternion is 0.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> checker.distance([2.0, 3.0], exact=True, gradient=True).gradient.round(9) + 0.0
        array([-1.,  0.])
        """
        checked, ready, _ = self._at(Q, t)
        exact, gradient = _validate.flag(exact, "exact"), _validate.flag(gradient, "gradient")
        if gradient and not exact:
            raise InputError("gradient: expected exact=True with it, found exact=False: bounds have no gradient")
        gap = distances.nearest(ready, checked, exact, gradient)
        return gap if ready.paths is None or gap.gradient is None else replace(gap, gradient=self._own(gap))

    @overload
    def clearance(self, Q: ArrayLike, *, softness: float = ..., gradient: Literal[False] = ...) -> OneOrMany: ...
    @overload
    def clearance(
        self, Q: ArrayLike, *, softness: float = ..., gradient: Literal[True]
    ) -> tuple[OneOrMany, Floats]: ...
    def clearance(
        self, Q: ArrayLike, *, softness: float = 0.005, gradient: bool = False
    ) -> OneOrMany | tuple[OneOrMany, Floats]:
        """Compute a smooth certified lower bound on the distance of the nearest pair, and its gradient.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        softness : float
            Softness in metres. The bound lies below the least gap by at most the softness times the logarithm of the
            number of pairs of pieces. A smaller softness gives a tighter bound with sharper bends.
        gradient : bool
            Also compute the derivative of the bound with respect to the configuration.

        Returns
        -------
        clearance : float or ndarray, shape (...)
            The bound in metres; negative if outer ellipsoids overlap. Margins are ignored.
        gradient : ndarray, shape (..., dof)
            The derivative in metres per radian or metre; only if requested.

        Raises
        ------
        InputError
            As for `collide`; also if there is no pair to check, or the softness is not positive and finite.
        ConvergenceError
            If squares of positions overflow.

        See Also
        --------
        distance : The exact distance, a function with kinks.

        Notes
        -----
        The gap between two ellipsoids is the distance between their supporting planes perpendicular to their contact
        normal, n·r (1 - 1/√F) / ‖n‖, with the normal n, the vector r between the centers, and the contact function F of
        Perram and Wertheim. This gap is at most the ellipsoids' signed distance, and analytic except where centers
        coincide. The result is -softness log Σ exp(-g / softness) over the gaps g between the outer ellipsoids of all
        pairs of pieces, minus a bound on rounding. Each static surface or cloud contributes up to 128 ellipsoids around
        its parts, unless it is a solid. Near a large cube, such as a `Body.half_space`, the result is always negative,
        so use a thin box as a floor. Where the centers of two ellipsoids coincide, the pair contributes nothing to the
        gradient; where they nearly coincide, the gradient is finite but may be huge. The derivative with respect to a
        quaternion is as in `distance`.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("ball", Body.sphere(0.1), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> clearance, gradient = checker.clearance([1.9, 3.0], gradient=True)
        >>> clearance <= checker.distance([1.9, 3.0], exact=True).distance
        True
        """
        checked = self.robot.checked(Q)
        softness, gradient = _validate.positive_scalar(softness, "softness"), _validate.flag(gradient, "gradient")
        lower, slopes = distances.clearances(self._ready(), edges.flat(checked), softness, gradient)
        batch = checked.shape[:-1]
        values: OneOrMany = lower.reshape(batch) if batch else float(lower[0])
        return (values, slopes.reshape(checked.shape)) if gradient else values

    def distance_by_pair(
        self, Q: ArrayLike, t: ArrayLike | None = None, *, within: float, gradient: bool = False
    ) -> PairDistances:
        """Compute the exact distance of every pair whose bodies are within a given distance of each other.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        t : float or array_like, shape (...), optional
            As for `collide`.
        within : float
            The largest distance at which a pair is listed, in metres, >= 0. Pairs in contact are always listed. Margins
            are ignored.
        gradient : bool
            Also compute the derivatives of the distances with respect to the configuration.

        Returns
        -------
        PairDistances
            One entry for each configuration and each pair within this distance, ordered by configuration.

        Raises
        ------
        InputError
            As for `collide`, or if `within` is not a number >= 0.
        ConvergenceError
            As for `loewner.distance`.

        Examples
        --------
        >>> from loewner import Body, CollisionChecker
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 3.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> found = checker.distance_by_pair([[2.0, 3.0], [0.0, 3.0]], within=0.75)
        >>> for k, names, d in zip(found.configuration, found.names, found.distance):
        ...     print(k, *names, d.round(6))
        0 rail forearm 0.481002
        0 cart post 0.7
        1 rail forearm 0.481015
        """
        checked, ready, _ = self._at(Q, t)
        within, gradient = _validate.positive_scalar(within, "within", zero=True), _validate.flag(gradient, "gradient")
        gaps = distances.by_pair(ready, edges.flat(checked), within, gradient)
        return gaps if ready.paths is None or gaps.gradient is None else replace(gaps, gradient=self._own(gaps))

    # -- inside -------------------------------------------------------------------------------

    def _at(self, Q: ArrayLike, t: ArrayLike | None) -> tuple[Floats, Problem, Floats | None]:
        """Check configurations and times.

        Return the configurations with the values of moving bodies, the prepared pairs, and a time per configuration.
        """
        checked, ready = self.robot.checked(Q), self._ready(timed=t is not None)
        if t is None:
            return checked, ready, None
        times = _validate.finite_array(t, "t", ("...",))
        shape = _validate.broadcast({"Q": checked.shape[:-1], "t": times.shape})
        rows = edges.flat(np.broadcast_to(checked, (*shape, checked.shape[-1])))
        times = np.broadcast_to(times, shape).ravel()
        full_rows = in_time.with_bodies(ready, rows, times)
        return np.array(full_rows.reshape(*shape, full_rows.shape[1]), order="C"), ready, times

    def _doubted(self, ready: Problem, Q: Floats, t: Floats | None, out: NDArray[np.int8]) -> NDArray[np.int8]:
        """Return FREE if all poses within the errors are free, COLLIDING if the given poses collide, else AMBIGUOUS."""
        timed = t is not None and ready.paths is not None and ready.paths.bounds
        if ready.given is None and not timed:
            return out
        free = in_time.free_at(ready, Q, t) if t is not None and timed else out == codes.FREE
        hit = verdicts.classified(ready.as_given, codes.CERTIFY, Q).verdicts == codes.COLLIDING
        return np.where(free, codes.FREE, np.where(hit, codes.COLLIDING, codes.AMBIGUOUS)).astype(np.int8)

    def _own(self, found: StateDistance[Any, Any] | PairDistances) -> Floats:
        """Return a gradient without the columns of bodies that follow motions."""
        return np.ascontiguousarray(np.asarray(found.gradient)[..., : self.robot.dof])

    def _exact(self, ready: Problem, Q: Floats) -> Verdicts:
        """Decide the verdict and the tier of each configuration; raise ConvergenceError if any is unsettled."""
        flat = edges.flat(Q)
        answers = verdicts.classified(ready, codes.EXACT, flat)
        self._learn(ready, len(flat))
        verdicts.expect_settled(ready, flat, answers.verdicts)
        return answers

    def _learn(self, ready: Problem, count: int) -> None:
        """Reorder the pairs from time to time, so that the pairs that have collided most often come first."""
        self._seen += count
        if self._seen >= self._next_look and self._prepared[2] is ready:
            self._next_look = 2 * self._seen
            if ready.hits.sum() >= self._seen and not self._suspected:
                self._suspected = True
                self._doubt_pairs(ready)
            self._keep(ready.with_order(np.argsort(-ready.hits, kind="stable")))

    def _doubt_pairs(self, ready: Problem) -> None:
        """Warn if all configurations so far have collided, and one pair also collides in all random configurations."""
        if ready.paths is not None:
            return
        tried = self._robot.random_configurations(SUSPECTED)
        for pair in np.flatnonzero(verdicts.always(ready, tried))[:1]:
            a, b = (ready.names[n] for n in ready.pairs[pair])
            descriptions = [(name, self._robot.shapes.get(name)) for name in (a, b)]
            shapes = "".join(f" ({name!r}: {'; '.join(words)})" for name, words in descriptions if words)
            warn(
                f"{self._robot.name}: {a!r} and {b!r} collide in each of {self._seen + SUSPECTED} configurations, "
                f"{SUSPECTED} of them random{shapes}; if the links' shapes are larger than the links, read them as "
                "solids where hulls stick out (meshes='auto'), as pieces (meshes='pieces') or as they are "
                "(meshes='surface'); if they may touch, disable the pair in an SRDF, or by allowed= or Scene.allow; "
                "otherwise move the bodies apart (this warning is given once)"
            )

    def _keep(self, ready: Problem) -> None:
        # Fast queries of one configuration have no argument for the time.
        timed = ready.paths is not None
        self._prepared = (-1, None, ready) if timed else (ready.version, ready.single, ready)

    def _ready(self, *, timed: bool = False) -> Problem:
        """Return the prepared pairs; prepare them again if the scene has changed.

        Raises
        ------
        InputError
            If bodies of the scene follow motions and the query is not `timed`.
        """
        ready = self._prepared_now()
        if ready.paths is not None and not timed:
            names = ", ".join(self._scene.following)
            raise InputError(
                f"expected a time, since bodies of the scene follow motions ({names}): collide, classify, pairs and "
                "distances take t=, certify_edges takes t0= and t1=, and planners.plan_in_time plans (on the command "
                "line: loewner plan, and loewner audit of a trajectory with times). Other "
                "queries and planners have no time and cannot be used while such bodies are in the scene; without "
                "them, use a copy of the scene (scene.copy, scene.remove)"
            )
        return ready

    def _prepared_now(self) -> Problem:
        ready: Problem | None = self._prepared[2]
        if ready is not None and ready.version == self._scene.version:
            return ready
        # These poses are a snapshot. If another thread changes the scene in the meantime, the next query notices.
        moved = None if ready is None else poses_since(self._scene, ready.structure_version)
        if ready is not None and moved is not None:
            poses, paths, bounds, version = moved
            ready = ready.with_poses(poses, version)
            ready = ready.with_paths(paths, bounds) if paths or bounds else ready
        else:
            scene = self._scene.snapshot()
            ready = prepared(self._robot, scene, self._skipped, scene.version, ready)
            self._seen, self._next_look, self._suspected = 0, FIRST_LOOK, False
            if not self._is_near:
                self._doubt_lengths(scene)
        self._keep(ready)
        return ready

    def _doubt_lengths(self, scene: Scene) -> None:
        """Warn if all static bodies of the scene are far beyond the robot's reach."""
        standing = [name for name in scene.static_names if not _is_empty(scene[name])]
        if not standing:
            return
        self._is_near = True
        robot = self._robot
        poses = robot.forward_kinematics(robot.random_configurations(TRIED))
        away = lengths(poses[:, :, :3, 3] - poses[:, :1, :3, 3])
        reach = float(away.max()) + max(map(reach_of, robot.bodies.values()))
        link, body = next((link, body) for link, body in robot.bodies.items() if not _is_empty(body))
        place = poses[0, robot.link_names.index(link)]
        if not any(collide(body, place, scene[name], scene.pose(name), margin=FAR * reach) for name in standing):
            warn(
                f"scene: expected lengths in metres, found no body within {FAR * reach:.3g} m of {robot.name}, "
                f"which reaches about {reach:.3g} m; is it in millimetres?"
            )


def _is_empty(body: Body) -> bool:
    return bool(packed_of(body).piece_start[-1] == 0)


def _warn_of_refuted(robot: Robot) -> None:
    """Warn if `Robot.prove_pairs` has found collisions of pairs that are exempt from checking."""
    wrong = pair_cache.refuted(robot)
    if wrong:
        worst = min(wrong, key=lambda row: row.distance)
        others = "" if len(wrong) == 1 else f", and {len(wrong) - 1} more"
        warn(
            f"pairs that are exempt from checking can collide: {worst.names[0]} and {worst.names[1]} of {robot.name}, "
            f"{1e3 * max(-worst.distance, 0.0):.3g} mm deep{others}; see Robot.prove_pairs (loewner clash --exempt)"
        )


def _begin_and_end(t0: Any, t1: Any) -> tuple[Floats, Floats] | None:
    """Check and broadcast the times at which motions begin and end; return None if there are none."""
    if t0 is None and t1 is None:
        return None
    if t0 is None or t1 is None:
        raise InputError(f"expected both t0 and t1, found {'t1' if t0 is None else 't0'} only")
    begin, end = _validate.finite_array(t0, "t0", ("...",)), _validate.finite_array(t1, "t1", ("...",))
    _validate.broadcast({"t0": begin.shape, "t1": end.shape})
    begin, end = np.broadcast_arrays(begin, end)
    for k in np.flatnonzero(~(begin <= end))[:1]:
        raise InputError(f"t1: expected times at or after t0, found {begin.flat[k]:.15g} and then {end.flat[k]:.15g}")
    with np.errstate(over="ignore"):
        if not np.isfinite(end - begin).all():
            raise InputError("t0, t1: expected finite durations, found others")
    return begin, end


def prepared_of(checker: CollisionChecker, *, timed: bool = False) -> Problem:
    """Return a checker's pairs, prepared for the current state of its scene, for several queries of that state.

    Raises
    ------
    InputError
        If bodies of the scene follow motions and the queries are not `timed`.
    """
    return checker._ready(timed=timed)


def without_motions(checker: CollisionChecker) -> CollisionChecker:
    """Return a checker for the same pairs in the present scene, without the bodies that follow motions."""
    if not checker.scene.following:
        return checker
    version = checker.scene.version
    if checker._still is None or checker._still[0] != version:
        scene = checker.scene.copy()
        for name in scene.following:
            scene.remove(name)
        still_checker = CollisionChecker(checker.robot, scene)
        still_checker._skipped = checker._skipped
        checker._still = version, still_checker
        return still_checker
    return checker._still[1]
