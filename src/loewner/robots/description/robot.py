"""Define robots: links connected by joints, their bodies, and the poses of the links at many configurations."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _elementary, _validate
from loewner._base._guard import guarded
from loewner._base._kept import kept
from loewner._base._matrices import dot, lengths, power
from loewner._base._pictures import LINKS, Shape, bodies, pictured
from loewner._base._plausible import FARTHEST_LIMIT
from loewner._base._read_only import KeepsReadOnly, read_only
from loewner._base._threads import in_shares
from loewner._base._validate import Bools, Floats, Named, OneOrMany, Pair, Progress
from loewner._kernels import columns as kernel_columns
from loewner._kernels.records import Tree
from loewner._native import entries
from loewner.bodies import Body, for_pictures, packed_of
from loewner.ellipsoids.fits import checked_tolerance
from loewner.errors import InputError, UnknownNameError
from loewner.robots.description import assembly, other_models, reaching
from loewner.robots.description.assembly import Part, Source
from loewner.robots.description.drake import drake_model
from loewner.robots.description.link_bodies import MODELS, PRIMITIVES, USUAL_MODEL, MeshModel, link_bodies
from loewner.robots.description.links import Joint as LinkJoint
from loewner.robots.description.links import described
from loewner.robots.description.mjcf import description_of, qpos_columns, semantics_of
from loewner.robots.description.other_models import Layout, Model, Order, expect, layout_of
from loewner.robots.description.pair_verdicts import ProvenPairs, Terms
from loewner.robots.description.pinocchio import pinocchio_model
from loewner.robots.description.srdf import Semantics, State, read_srdf
from loewner.robots.description.tree import adjacent_pairs, columns_of, placed_tree, tree_of
from loewner.robots.description.urdf import RATES, VALUES, Description, Joint, doubt_limits, read_urdf
from loewner.robots.description.watch import Watch
from loewner.robots.description.xacro_files import SUFFIX, Expansion
from loewner.scenes.mjcf_models import MjcfModel, compiled_model, name_of, read_mjcf
from loewner.scenes.scene import Scene

if TYPE_CHECKING:
    from loewner.meshes.coverage import CoverReport

# Allowed deviation of a quaternion's norm from 1: far more than rounding causes, far less than interpolation causes.
QUATERNION_TOLERANCE = 1e-6

# Kinds of joints whose last four values are a quaternion.
WITH_QUATERNION = ("floating", "ball")

# If a robot has more links than this number, its balls are drawn more coarsely in pictures.
MANY_LINKS = 30

# Smallest number of configurations that a thread takes at a time: about 0.1 ms of work.
LEAST_SHARE = 1024

# Formats of files that describe the shapes of links; see `Robot.with_cover` and `Robot.save_cover`.
CoverFormat = Literal["curobo", "vamp", "foam", "pyroki", "urdf", "mjcf", "scene"]

# Implementations of `Robot.prove_pairs`, `free_range`, `swept` and the methods for covers. The modules that implement
# these methods import this module, so they register their functions here.
answers: dict[str, Callable[..., Any]] = {}


def _text_of(
    path: str | os.PathLike[str] | None, text: str | None, xacro_args: Any, expansion: Expansion
) -> str | None:
    """Return the text of a URDF that is given as a string or as a xacro file; None for other files."""
    if path is None and text is None:
        raise InputError("path: expected a path to a URDF, found None, and no text of one (text=) either")
    if path is not None and text is not None:
        raise InputError("text: expected a path to a URDF or its text, found both")
    if text is not None and not isinstance(text, str):
        raise InputError(f"text: expected the text of a URDF, found {_validate.short(text)}")
    if path is None:
        if xacro_args is not None:
            raise InputError("xacro_args: expected a path to a xacro file with them, found text=")
        return text
    named = _validate.path(path, "path", wanted="a path to a URDF")
    if xacro_args is None and not str(named).lower().endswith(SUFFIX):
        return None
    return expansion.text(named)


def _model(meshes: str, decompose: bool) -> str:
    """Return the representation of meshes that the arguments `meshes` and `decompose` select."""
    _validate.choice(meshes, "meshes", MODELS)
    if not _validate.flag(decompose, "decompose"):
        return meshes
    if meshes == "surface":
        raise InputError(f"decompose: expected False with meshes={meshes!r}, found True; surfaces are not split")
    return "pieces"


@dataclass(frozen=True, eq=False, repr=False)
class Robot(KeepsReadOnly):
    """A tree of links connected by joints; read a robot with `from_urdf` or `from_mjcf`, or join several with `join`.

    Attributes
    ----------
    name : str
    link_names : tuple of str
        Names of the links, parents before children. The index of a link is its row in `forward_kinematics`.
    joint_names : tuple of str
        Joints with values of their own, that is, movable joints that do not mimic another joint, in the order of the
        URDF.
    configuration_names : tuple of str
        Names of the entries of a configuration. A joint with one value (rad or m) appears under its own name; a planar
        joint j has "j/x", "j/y" [m] and "j/theta" [rad]; a floating joint has "j/x", "j/y", "j/z" [m] and the unit
        quaternion "j/qw", "j/qx", "j/qy", "j/qz"; a ball joint, which exists only in MJCF, has only the four quaternion
        entries.
    lower, upper : ndarray, shape (dof,)
        Limits for sampling, planning and `reach`, in radians for joints that turn and metres for joints that slide;
        infinite for values without limits. These limits respect both the file's limits and its soft limits
        (``<safety_controller>``), and keep each mimicking joint within its own limits. All functions accept
        configurations outside the limits; the first configuration far outside them causes a warning (see `checked`).
    hard_lower, hard_upper : ndarray, shape (dof,)
        Limits of the joints, as given in the file. A plan may start outside `lower` and `upper`, but not outside these
        limits.
    velocity, acceleration, jerk : ndarray, shape (dof,)
        Upper limits on the velocity [rad/s or m/s], the acceleration [rad/s² or m/s²] and the jerk [rad/s³ or m/s³] of
        each value: the URDF's limits, or lower values if a mimicking joint would otherwise exceed its own limit. NaN if
        the URDF gives no positive limit, and for planar and floating joints. Only URDF 1.2 has acceleration and jerk
        limits.
    bodies : dict
        Maps the names of links with collision geometry to a `Body` in the frame of the link. In `bodies`, `shapes`,
        `groups` and `states`, looking up an unknown name raises an UnknownNameError that lists the known names.
    shapes : dict
        Maps link names to descriptions of the bodies of their collision shapes, in the order of the URDF: "box", "hull,
        sticks out by up to 0.4 mm", "pieces, 3 that stick out by up to 2 mm", "solid, 1,234 triangles", "surface
        without an inside, 96 triangles", "solid of a nearly closed mesh, 804 triangles", "hull of an open mesh".
    groups : dict
        Maps group names to joint names, from the SRDF.
    states : dict
        Maps state names to (group, {joint: value}), from the SRDF; a joint with several values has a tuple in the order
        of `configuration_names`. If several groups have a state with the same name, the second state is called
        "group/name".
    disabled_pairs : frozenset
        Sorted pairs of links that the SRDF exempts from checking.
    adjacent_pairs : frozenset
        Sorted pairs of links with bodies. The links of a pair are connected directly by a joint, or by a chain of links
        without bodies in which at most one joint moves.
    mimics : dict
        Maps the name of each mimicking joint to the name of the joint that it mimics and the factor between their
        rates.
    tree : Tree
        Arrays for the kernels, described in ``loewner/_kernels/robots/kinematics.py``.
    urdf : Path
        The file that was read: a URDF or an MJCF. For a description given as a string, or a robot made in memory, the
        path is a placeholder name in the current working directory.
    package_dirs : tuple of Path
        Additional folders that were searched for meshes.

    Examples
    --------
    A cart on a rail of 2 m that carries an arm (``arm.urdf``):

    >>> robot = Robot.from_urdf("arm.urdf")
    >>> robot.configuration_names, robot.lower, robot.upper
    (('rail', 'elbow'), array([  0., -inf]), array([ 2., inf]))
    >>> robot.forward_kinematics([[0.0, 0.0], [1.5, 0.0]])[:, 1, :3, 3]  # where the cart is
    array([[0. , 0. , 0. ],
           [1.5, 0. , 0. ]])
    """

    name: str
    link_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    configuration_names: tuple[str, ...]
    lower: Floats
    upper: Floats
    hard_lower: Floats
    hard_upper: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats
    bodies: dict[str, Body]
    shapes: dict[str, tuple[str, ...]]
    groups: dict[str, tuple[str, ...]]
    states: dict[str, State]
    disabled_pairs: frozenset[Pair]
    adjacent_pairs: frozenset[Pair]
    mimics: dict[str, tuple[str, float]]
    tree: Tree
    urdf: Path
    package_dirs: tuple[Path, ...]
    _columns: dict[str, slice]
    # Maps each link except roots to the joint above it ("" if the joint has no name) and its parent (None for the
    # world).
    _above: dict[str, tuple[str, str | None]]
    # Links that have only visual geometry; messages name them.
    _only_visual: tuple[str, ...]
    _watch: Watch
    # The tree with the root link at the origin.
    _rooted: Tree
    # The descriptions from which the robot and its parts were read.
    _sources: tuple[Source, ...]
    # Whether an SRDF or an MJCF has rules about pairs. With rules, no adjacent pair is exempt by default.
    _ruled: bool
    # The robots that were joined, by name.
    _parts: dict[str, Part[Robot]] = field(default_factory=dict)
    # Bodies that were added to the world. The robot's pose does not move them.
    _in_world: tuple[str, ...] = ()
    # The order of values in the model from which the robot was made.
    _layout: Layout | None = None

    @classmethod
    @guarded
    def from_urdf(
        cls,
        path: str | os.PathLike[str] | None = None,
        *,
        text: str | None = None,
        xacro_args: Mapping[str, str | float | bool] | None = None,
        srdf: str | os.PathLike[str] | None = None,
        package_dirs: str | os.PathLike[str] | Iterable[str | os.PathLike[str]] = (),
        meshes: MeshModel = USUAL_MODEL,
        decompose: bool = False,
        pairs: Literal["adjacent", "proven"] | None = None,
        tol: float = 1e-4,
        cache: bool = True,
        progress: Progress | None = None,
    ) -> Robot:
        """Read a robot from a URDF.

        Parameters
        ----------
        path : path, optional
            A URDF file. If its name ends in ``.xacro``, the package xacro expands it (``pip install
            "loewner[xacro]"``). The expansion evaluates Python expressions in the file, so read only files that you
            trust. For a ``.xacro`` file, line numbers in messages refer to the expanded text.
        text : str, optional
            The contents of a URDF or xacro file, given instead of `path`; for instance, the text in ROS's
            ``/robot_description``. Relative paths of meshes in the text are resolved from the working directory.
        xacro_args : mapping of str to str, number or bool, optional
            Values for the arguments of a xacro file. If `xacro_args` is given, a file is expanded even if its name does
            not end in ``.xacro``. ``$(find package)`` is the folder of a package; see `package_dirs`.
        srdf : path, optional
            A file with groups, states and disabled pairs. A file whose name ends in ``.xacro`` is expanded first.
        package_dirs : path or iterable of paths
            Packages, or folders that contain packages, in which to find ``package://`` and ``model://`` paths. The
            folders in ROS's environment variables and the folders above the URDF are also searched.
        meshes : {"auto", "hull", "pieces", "surface"}
            Representation of each collision mesh. "auto", the default: a closed mesh becomes its hull or the solid that
            it encloses. The hull is used if it is proven to stick out by at most the larger of 1 mm and 1 % of the
            mesh's diameter. Holes of a nearly closed mesh are closed first; any other open mesh becomes its hull. The
            attribute `shapes` describes the results. "hull": the convex hull, which contains the mesh. "pieces": convex
            pieces, into which `Body.from_mesh` splits a non-convex mesh. "surface": the mesh's triangles
            (`Body.from_surface`), and the space that they enclose if the mesh is closed.
        decompose : bool
            True means the same as ``meshes="pieces"``.
        pairs : {"adjacent", "proven"}, optional
            Which pairs are exempt from checking if there is no SRDF. "adjacent", the default: links that are connected
            by a joint. "proven": in addition, the pairs that are proven to collide at no configuration, or at all
            configurations (`prove_pairs`).
        tol : float
            Largest certified log-volume gap of all fits.
        cache : bool
            Keep the bodies of meshes and the proofs of pairs on disk, keyed by content, so that later calls only read
            them.
        progress : callable, optional
            Called as ``progress(done, total)`` after each collision shape.

        Returns
        -------
        Robot

        Raises
        ------
        FileError
            If a file is missing or cannot be read, or one of `package_dirs` is not a folder. For a mesh, the message
            names the mesh's link and the places searched.
        InputError
            If neither or both of `path` and `text` are given. If `path` is not a path (but XML, for instance), or the
            SRDF is a URDF. If the links do not form a tree, or a joint is not well defined.
        GeometryError
            If a shape is flat or has no size.
        UnknownNameError
            If a joint names a link that does not exist, or if hardly any of the links and joints that the SRDF names
            belong to this robot.
        MissingExtraError
            If a mesh is to be decomposed and CoACD is not installed, or a xacro file is to be expanded without xacro.

        Warns
        -----
        UserWarning
            If ``meshes="auto"`` and meshes are not closed; one warning names all open meshes. If the URDF or the SRDF
            has parts that its format does not define (docs/robots.md). If a joint mimics a joint that does not exist,
            or the limits of a mimicking joint would leave hardly any range to the joint that it mimics. If a body is
            probably not in metres, or the angles of an origin or the limits of revolute joints are probably not in
            radians.

            If the SRDF is for a robot with a different name, names unknown links or joints, names no known links or
            joints, or contains passive joints or a moving base.

        Examples
        --------
        >>> Robot.from_urdf("arm.urdf")
        Robot('arm', 3 links, 3 with bodies, 2 joints, dof 2)
        """
        tol, cache, model = checked_tolerance(tol), _validate.flag(cache, "cache"), _model(meshes, decompose)
        if pairs is not None:
            _validate.choice(pairs, "pairs", ("adjacent", "proven"))
            if srdf is not None:
                raise InputError("pairs: expected none with an SRDF, which lists the pairs that need no check")
        progress = _validate.reporter(progress)
        folders = [package_dirs] if isinstance(package_dirs, (str, os.PathLike)) else package_dirs
        listed = _validate.listed(folders, "package_dirs", wanted="a path or several")
        places = [_validate.path(folder, "package_dirs") for folder in listed]
        expansion = Expansion(_validate.mapping(xacro_args, "xacro_args", "from names to values"), places, set())
        text = _text_of(path, text, xacro_args, expansion)
        rules = None
        if srdf is not None and str(_validate.path(srdf, "srdf", wanted="a path to an SRDF")).lower().endswith(SUFFIX):
            rules = expansion.text(srdf)
        expansion.refuse_unused()
        robot = read_urdf("URDF text" if path is None else path, text)
        semantics = Semantics() if srdf is None else read_srdf(srdf, robot, rules)
        bodies, shapes = link_bodies(robot, places, model=model, tol=tol, cache=cache, progress=progress)
        new_robot = cls._of(robot, bodies, semantics, adjacent_pairs(robot), places, "URDF", text, shapes)
        if pairs != "proven" or not new_robot.bodies:
            return new_robot
        others = [pair for pair in combinations(sorted(new_robot.bodies), 2) if pair not in new_robot.adjacent_pairs]
        return new_robot.disabling(
            new_robot.adjacent_pairs | new_robot.prove_pairs(others, cache=cache, progress=progress).exempt
        )

    @classmethod
    def _of(
        cls,
        robot: Description,
        bodies: Mapping[str, Body],
        semantics: Semantics,
        adjacent: frozenset[Pair],
        places: Iterable[Path],
        format: str,
        text: str | None,
        shapes: Mapping[str, tuple[str, ...]] | None = None,
    ) -> Robot:
        """Build the robot from the parsed files."""
        columns, dof = columns_of(robot)
        kinds = {name: robot.joints[name].kind for name in columns}
        limits: dict[str, Any] = {kind: _rates(robot, columns, dof, kind) for kind in RATES}
        limits["lower"], limits["upper"] = _ends(robot, columns, dof, lambda joint: joint.range)
        hard = _ends(robot, columns, dof, lambda joint: (joint.lower, joint.upper))
        limits["hard_lower"], limits["hard_upper"] = hard
        read_only(*limits.values())
        entries = [(name, value) for name in columns for value in VALUES[kinds[name]]]
        names = tuple(f"{name}/{value}" if value else name for name, value in entries)
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"joints: expected values with different names, found two of {name!r}")
        turns = [kinds[name] in ("revolute", "continuous") for name, _ in entries]
        free = [kinds[name] in ("planar", *WITH_QUATERNION) for name, _ in entries]
        tree = tree_of(robot, columns)
        # Make paths absolute: the visual geometry is read later, perhaps from another working directory.
        path, package_dirs = robot.path.absolute(), tuple(place.absolute() for place in places)
        return cls(
            name=robot.name,
            link_names=tuple(robot.shapes),
            joint_names=tuple(columns),
            configuration_names=names,
            **limits,
            bodies=Named("link with a body", bodies),
            shapes=Named("link with shapes of a URDF", shapes or {}),
            groups=Named("group", semantics.groups),
            states=Named("state", semantics.states),
            disabled_pairs=semantics.disabled_pairs,
            adjacent_pairs=adjacent,
            mimics={j.name: (j.mimic.joint, j.mimic.multiplier) for j in robot.joints.values() if j.mimic is not None},
            tree=tree,
            urdf=path,
            package_dirs=package_dirs,
            _columns=columns,
            _above={link: (joint.name, joint.parent) for link, joint in robot.joint_above.items()},
            _only_visual=robot.only_visual,
            _watch=Watch(robot.name, names, *hard, turns, free),
            _rooted=tree,
            _sources=(Source("", format, path, text, package_dirs),),
            _ruled=semantics.ruled,
        )

    @classmethod
    @guarded
    def from_mjcf(cls, path: str | os.PathLike[str], *, tol: float = 1e-4) -> Robot:
        """Read a robot, with the world around it, from an MJCF file, using MuJoCo's compiler.

        A configuration equals MuJoCo's `qpos`, entry by entry. Pairs that MuJoCo does not check for collisions are in
        `disabled_pairs`, and keyframes are in `states`. docs/howto/mujoco.md lists the correspondences.

        Parameters
        ----------
        path : path
            MJCF file, or a URDF that MuJoCo accepts.
        tol : float
            Upper limit on the certified log-volume gap of every fit to a mesh.

        Returns
        -------
        Robot
            The root link is the world, and each colliding geom of the world is a separate link fixed to the root. Every
            MuJoCo body is a link, with the frame that the body has in MuJoCo. If several joints move one link, they are
            chained through links without bodies.

        Raises
        ------
        FileError
            If the file is missing, or MuJoCo refuses it.
        InputError
            If a colliding geom is a signed distance field.
        GeometryError
            If a colliding mesh is flat.
        MissingExtraError
            If MuJoCo is not installed.

        Warns
        -----
        UserWarning
            If the file has parts that MuJoCo simulates but this function does not read, such as flexible bodies and
            constraints. If limits of hinges, after MuJoCo's conversion, are probably not in radians.

        Examples
        --------
        >>> from pathlib import Path
        >>> _ = Path("pole.xml").write_text('''
        ... <mujoco model="pole"><worldbody>
        ...   <geom name="floor" type="plane" size="1 1 1"/>
        ...   <body name="pole" pos="0 0 0.5"><joint name="swing" axis="0 1 0"/>
        ...     <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.05"/></body>
        ... </worldbody></mujoco>''')
        >>> robot = Robot.from_mjcf("pole.xml")
        >>> robot.link_names, robot.configuration_names
        (('world', 'floor', 'pole'), ('swing',))
        """
        return cls._of_mjcf(read_mjcf(path, checked_tolerance(tol)), "MJCF")

    @classmethod
    @guarded
    def from_mujoco(cls, model: Any, data: Any = None, *, couplings: bool = True, tol: float = 1e-4) -> Robot:
        """Read a robot, with the world around it, from a MuJoCo model in memory.

        As for `from_mjcf`, pairs that MuJoCo does not check are in `disabled_pairs`, and keyframes are in `states`.
        `imported` and `exported` convert configurations from and to `qpos`.

        Parameters
        ----------
        model : mujoco.MjModel
        data : mujoco.MjData, optional
            Supplies the poses of mocap bodies and the active constraints. By default, the model supplies them.
        couplings : bool
            Let a joint follow another joint if an active equality constraint couples them linearly. If `couplings` is
            False, or there are no such constraints, a configuration equals `qpos`, entry by entry.
        tol : float
            Upper limit on the certified log-volume gap of every fit to a mesh.

        Returns
        -------
        Robot
            As for `from_mjcf`.

        Raises
        ------
        InputError
            If `model` or `data` is not an object of MuJoCo, or `data` belongs to a different model. If a colliding geom
            is a signed distance field.
        GeometryError
            If a colliding mesh is flat.

        Warns
        -----
        UserWarning
            As for `from_mjcf`.

        Examples
        --------
        >>> import mujoco
        >>> model = mujoco.MjModel.from_xml_string('''
        ... <mujoco model="gripper"><worldbody><body name="left"><joint name="open" type="slide" range="0 0.1"/>
        ...   <geom size="0.1"/></body><body name="right" pos="0.5 0 0"><joint name="follow" type="slide"/>
        ...   <geom size="0.1"/></body></worldbody>
        ...   <equality><joint joint1="follow" joint2="open" polycoef="0 -1 0 0 0"/></equality></mujoco>''')
        >>> robot = Robot.from_mujoco(model)
        >>> robot.configuration_names, robot.exported([0.1])
        (('open',), array([ 0.1, -0.1]))
        """
        expect(model, "MjModel", "model")
        if data is not None:
            expect(data, "MjData", "data")
            if (len(data.qpos), len(data.mocap_pos), len(data.eq_active)) != (model.nq, model.nmocap, model.neq):
                raise InputError("data: expected that of the model, found that of another one")
        coupled, path = _validate.flag(couplings, "couplings"), Path(name_of(model) or "model")
        return cls._of_mjcf(compiled_model(model, data, path, checked_tolerance(tol), couplings=coupled), "links")

    @classmethod
    def _of_mjcf(cls, model: MjcfModel, format: str) -> Robot:
        """Make the robot of a model that MuJoCo has compiled."""
        robot, bodies = description_of(model)
        doubt_limits(robot.path, robot.joints)
        new_robot = cls._of(robot, bodies, semantics_of(model, robot), model.related_pairs, (), format, None)
        theirs = qpos_columns(robot)
        order = Order(sum(map(len, theirs.values())), theirs, {})
        references = {joint.name: joint.reference for joint in robot.joints.values()}
        return replace(new_robot, _layout=layout_of(order, new_robot, references))

    @classmethod
    @guarded
    def footprint(cls, polygon: ArrayLike, *, height: float, bounds: ArrayLike | None = None) -> Robot:
        """Make a mobile base from a polygon with a height; the base slides and turns on the plane z = 0.

        Parameters
        ----------
        polygon : array_like, shape (n, 2)
            Corners in the frame of the base, in metres, clockwise or counterclockwise. The polygon need not be convex.
        height : float
            Height in metres.
        bounds : array_like, shape (2, 2), optional
            Lowest and highest x, then lowest and highest y, in metres; planning requires these bounds.

        Returns
        -------
        Robot
            A robot whose link "footprint" moves on the joints ``base/x``, ``base/y`` and ``base/theta``, as from
            `add_base`. The base may move in any direction: a proven motion may require the base to drive sideways.

        Raises
        ------
        InputError
            If the polygon has fewer than three corners, is flat or crosses itself; if the height is not positive, or
            the bounds are not in order.

        Examples
        --------
        >>> base = Robot.footprint([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]], height=0.5)
        >>> base.configuration_names
        ('base/x', 'base/y', 'base/theta')
        """
        body = assembly.footprint_body(polygon, height)
        return cls.from_links({"footprint": body}, [], name="footprint").add_base("planar", bounds)

    @classmethod
    @guarded
    def from_links(
        cls,
        links: Mapping[str, Body | None | Iterable[tuple[Body, ArrayLike | None]]],
        joints: Iterable[LinkJoint],
        *,
        disabled: Iterable[Pair] | None = None,
        name: str = "robot",
    ) -> Robot:
        """Make a robot from links and joints in memory.

        Parameters
        ----------
        links : mapping from str to Body, None, or list of (Body, pose)
            The body of each link, in the frame of the link. None stands for a link without a body. For several bodies,
            pair each body with its pose in the frame of the link, of shape (4, 4) with translation in metres.
        joints : iterable of Joint
            Joints that connect all links to one root. The order of the joints is the order of the values in a
            configuration.
        disabled : iterable of pairs of str, optional
            Pairs of links that are exempt from checking; all other pairs are checked. Default: adjacent pairs are
            exempt, as for a URDF without an SRDF.
        name : str

        Returns
        -------
        Robot

        Raises
        ------
        InputError
            If links and joints do not form a tree, a name is used twice, or limits are not in order. If a joint is
            given an argument that does not apply to its kind.
        PoseError
            If a pose is not a rigid motion.
        UnknownNameError
            If a joint, a mimicking joint or a pair refers to a name that does not exist, or a joint's kind is unknown.

        Warns
        -----
        UserWarning
            If the limits of a mimicking joint would leave hardly any range to the joint that it mimics; if the limits
            of revolute joints are probably not in radians.

        Examples
        --------
        >>> from loewner import Joint
        >>> links = {"rail": Body.box([3, 0.2, 0.2]), "cart": Body.box([0.5, 0.5, 0.2])}
        >>> on_top = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.21], [0, 0, 0, 1]]
        >>> slide = Joint("slide", "prismatic", "rail", "cart", on_top, axis=[1, 0, 0], lower=-1, upper=1)
        >>> Robot.from_links(links, [slide])
        Robot('robot', 2 links, 2 with bodies, 1 joints, dof 1)
        """
        robot, bodies = described(links, joints, name)
        doubt_limits(robot.path, robot.joints)
        semantics = Semantics(ruled=disabled is not None)
        new_robot = cls._of(robot, bodies, semantics, adjacent_pairs(robot, bodies), (), "links", None)
        return new_robot if disabled is None else new_robot.disabling(disabled)

    @classmethod
    @guarded
    def from_drake(
        cls,
        plant: Any,
        scene_graph: Any,
        context: Any = None,
        *,
        mimic: Mapping[str, tuple[str, float, float]] | None = None,
        tol: float = 1e-4,
    ) -> Robot:
        """Read a robot, with the world around it, from a Drake plant and its scene graph.

        The pairs that Drake's collision filters exclude are in `disabled_pairs`. `imported` and `exported` convert
        configurations. docs/howto/other-models.md lists the correspondences.

        Parameters
        ----------
        plant : pydrake.multibody.plant.MultibodyPlant
            A finalized plant.
        scene_graph : pydrake.geometry.SceneGraph
        context : pydrake.systems.framework.Context, optional
            The context of the whole diagram, which supplies geometry, filters, poses of frames and locked joints.
            Locked joints become fixed. By default, the model supplies these values.
        mimic : mapping, optional
            Joints that follow other joints, as ``{joint: (other, gear ratio, offset)}`` with the robot's names. Pass
            these joints because Drake's Python interface cannot read couplers.
        tol : float
            Upper limit on the certified log-volume gap of every fit to a mesh.

        Returns
        -------
        Robot
            Every body of the plant is a link with the same name, or with the name MODEL::NAME if several models use the
            name. Each shape of the world is a separate link. A shape of another body is also a separate link if its
            filters differ from the filters of the body's first shape.

        Raises
        ------
        InputError
            If the plant is not finalized, a joint or a shape cannot be represented, or the context does not belong to
            the diagram.
        UnknownNameError
            If `mimic` names a joint that does not exist.
        GeometryError
            If a mesh is flat.

        Warns
        -----
        UserWarning
            If the plant has constraints that `mimic` does not represent, or geometry that is deformable or not part of
            the plant. If bodies that are fixed to each other collide, since such pairs are not checked.

        Examples
        --------
        >>> robot = Robot.from_drake(plant, scene_graph)  # doctest: +SKIP
        >>> CollisionChecker(robot).collide(robot.imported(plant.GetPositions(context)))  # doctest: +SKIP
        False
        """
        return cls._of_model(drake_model(plant, scene_graph, context, mimic or {}, checked_tolerance(tol)))

    @classmethod
    @guarded
    def from_pinocchio(
        cls,
        model: Any,
        geometry_model: Any,
        *,
        meshes: MeshModel = "surface",
        tol: float = 1e-4,
    ) -> Robot:
        """Read a robot, with the world around it, from a model of pinocchio and its collision geometry.

        The pairs of `geometry_model.collisionPairs` are checked; all other pairs are in `disabled_pairs`. `imported`
        and `exported` convert configurations. docs/howto/other-models.md lists the correspondences.

        Parameters
        ----------
        model : pinocchio.Model
        geometry_model : pinocchio.GeometryModel
        meshes : {"auto", "hull", "pieces", "surface"}
            Representation of triangle meshes, as for `from_urdf`. By default, a mesh consists of its triangles, as in
            Coal, and of the space that it encloses if it is closed.
        tol : float
            Upper limit on the certified log-volume gap of every fit to a mesh.

        Returns
        -------
        Robot
            Every body frame is a link with the same name. Each shape of the universe is a separate link. A shape of
            another link is also a separate link if it is not checked against the same shapes as the link's first shape.

        Raises
        ------
        InputError
            If a joint or a shape cannot be represented.
        GeometryError
            If a mesh is flat.

        Warns
        -----
        UserWarning
            If bodies that are fixed to each other collide, since such pairs are not checked. If there are shapes but no
            pairs. With ``meshes="auto"``, if meshes are not closed.

        Examples
        --------
        >>> robot = Robot.from_pinocchio(model, collision_model)  # doctest: +SKIP
        >>> CollisionChecker(robot).collide(robot.imported(q))  # doctest: +SKIP
        False
        """
        return cls._of_model(pinocchio_model(model, geometry_model, meshes, checked_tolerance(tol)))

    @classmethod
    def _of_model(cls, model: Model) -> Robot:
        """Make the robot of another library's model."""
        links, joints, disabled = other_models.with_shapes(model)
        robot = cls.from_links(links, joints, disabled=disabled, name=model.name)
        other_models.warn_of_fixed_contacts(model, robot)
        return replace(robot, _layout=layout_of(model.order, robot, {}))

    @guarded
    def exported(self, Q: ArrayLike) -> Floats:
        """Convert configurations to the order of the Drake, pinocchio or MuJoCo model from which this robot was made.

        Parameters
        ----------
        Q : array_like, shape (..., dof)

        Returns
        -------
        ndarray, shape (..., nq)
            Positions of Drake's plant, q of pinocchio, or qpos of MuJoCo, including the values of mimicking joints.

        Raises
        ------
        InputError
            If the robot was not made from such a model, or has gained values since then. After `join`, for example,
            convert the configurations of each part instead.

        Examples
        --------
        >>> robot.exported(plan.path)  # doctest: +SKIP
        """
        checked = self.checked(Q)
        return self._known_layout.exported(checked)

    @guarded
    def imported(self, q: ArrayLike, *, tolerance: float = 1e-6) -> Floats:
        """Convert configurations of this robot's model to the robot's own order; see `exported`.

        Parameters
        ----------
        q : array_like, shape (..., nq)
        tolerance : float
            Largest deviation [rad or m] of a mimicking or constant value from the value that the robot determines.

        Returns
        -------
        ndarray, shape (..., dof)

        Raises
        ------
        InputError
            If values deviate by more than the tolerance or are not finite, or if the width of `q` is not the model's
            number of values. Also as for `exported`.

        Examples
        --------
        >>> checker.collide(robot.imported(data.qpos))  # doctest: +SKIP
        False
        """
        layout = self._known_layout
        model_q = _validate.finite_array(q, "q", ("...", len(layout.source)))
        return self.checked(layout.imported(model_q, _validate.positive_scalar(tolerance, "tolerance", zero=True)))

    @property
    def _known_layout(self) -> Layout:
        if self._layout is None:
            raise InputError(
                "expected a robot with the values of a model of Drake, pinocchio or MuJoCo, found one that was not "
                "made from such a model, or has gained values since then"
            )
        return self._layout

    @guarded
    def as_scene(self, q: ArrayLike) -> Scene:
        """Return a scene of the robot's bodies at one configuration, for other robots to avoid.

        Parameters
        ----------
        q : array_like, shape (dof,)

        Returns
        -------
        Scene
            Bodies have the names of their links. Pairs that the robot exempts from checking may touch in the scene.

        Examples
        --------
        >>> scene = Robot.from_urdf("arm.urdf").as_scene([1.0, 0.0])
        >>> scene.names, scene.pose("cart")[:3, 3]
        (('rail', 'cart', 'forearm'), array([1., 0., 0.]))
        """
        poses = link_poses(self, self.checked_one(q)[None])[0]
        return scene_of(self, dict(zip(self.link_names, poses, strict=True)))

    def to_urdf(self, path: str | os.PathLike[str], *, mesh_prefix: str = "") -> None:
        """Write the robot as a URDF and an SRDF with the same stem, for other programs and for `from_urdf`.

        Together, the two files describe the robot's kinematics, limits, rates, groups, states and shapes, up to the
        rounding of poses. A `CollisionChecker` of the robot that is read from both files checks the same pairs. A root
        link "world" is added if the robot has several roots or is placed. Do not pass ``skip_adjacent=True`` to a
        checker of a robot with this link, since links fixed to "world" can count as adjacent. Visual geometry, masses
        and efforts are not written. If `lower` and `upper` are narrower than `hard_lower` and `hard_upper`, the
        narrower limits become soft limits.

        Pass both files to `from_urdf`: without the SRDF, pairs that this robot checks may be exempt. A solid is written
        as its triangles, which some other programs replace with the solid's convex hull. Existing files are replaced.

        Parameters
        ----------
        path : path
            The URDF. The SRDF has the suffix ``.srdf``. Meshes are written to files ``STEM-DIGEST.obj`` next to the
            URDF, as by `Body.to_urdf`.
        mesh_prefix : str
            Prefix for the names of mesh files in the URDF, for instance ``"package://my_robot/meshes/"``.

        Raises
        ------
        InputError
            If the robot has something that URDF cannot express: a ball joint, bounds of a floating base, a cone, an
            ellipsoid or a point cloud, or a surface that ``meshes="auto"`` would not read as the same solid. If a name
            contains unprintable characters, a dollar sign, or leading or trailing spaces, which readers would change;
            or if the path ends in ``.srdf`` or ``.xacro``.
        FileError
            If a file cannot be written.

        Examples
        --------
        >>> arm = Robot.from_urdf("arm.urdf")
        >>> Robot.join({"left": arm, "right": arm}).to_urdf("both.urdf")
        >>> Robot.from_urdf("both.urdf", srdf="both.srdf").configuration_names
        ('left/rail', 'left/elbow', 'right/rail', 'right/elbow')
        """
        from loewner.bodies.exports import prefix
        from loewner.robots.description.exports import save_urdf

        save_urdf(self, _validate.path(path, "path"), prefix(mesh_prefix))

    @property
    def _lists_pairs(self) -> bool:
        """Whether the exempt pairs are listed. Otherwise, adjacent pairs are exempt by default."""
        return self._ruled or bool(self.disabled_pairs)

    @property
    def _usually_skipped(self) -> frozenset[Pair]:
        """The pairs of links that a checker does not check by default."""
        return self.disabled_pairs if self._lists_pairs else self.disabled_pairs | self.adjacent_pairs

    @property
    def dof(self) -> int:
        """Number of entries of a configuration."""
        return len(self.configuration_names)

    def __repr__(self) -> str:
        kinds = Counter(words.partition(",")[0] for shapes in self.shapes.values() for words in shapes)
        models = {kind: count for kind, count in kinds.items() if kind not in PRIMITIVES}
        told = ", ".join(f"{kind} {count}" for kind, count in models.items()) if set(models) - {"hull"} else ""
        return (
            f"Robot({self.name!r}, {len(self.link_names)} links, {len(self.bodies)} with bodies, "
            f"{len(self.joint_names)} joints, dof {self.dof}{', quaternions wxyz' if self._quaternions else ''}"
            f"{told and f', meshes: {told}'})"
        )

    @pictured
    def _repr_html_(self) -> str:
        shapes, _, note = drawn(self)
        return bodies(shapes, note=note)

    def placed(self, T_world_base: ArrayLike) -> Robot:
        """Return the same robot with its root link at a pose of shape (4, 4) instead of the world's origin.

        If the robot has been placed before, the new pose replaces the old one. A robot that was made by `join` is
        placed as a whole: the poses of its parts are relative to this pose.

        Parameters
        ----------
        T_world_base : array_like, shape (4, 4)
            Translation in metres.

        Returns
        -------
        Robot

        Raises
        ------
        PoseError
            If the pose is not a rigid motion.

        Examples
        --------
        >>> robot = Robot.from_urdf("arm.urdf").placed([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]])
        >>> robot.forward_kinematics(robot.configuration())[0, :3, 3]
        array([0., 0., 5.])
        """
        T = _validate.pose(T_world_base, "T_world_base")
        assembly.refuse_bodies_in_world(self, "placed")
        return replace(self, tree=placed_tree(self._rooted, T), _parts=assembly.placed_parts(self._parts, T))

    part = assembly.part
    add_base = guarded(assembly.add_base)
    with_body = guarded(assembly.with_body)

    @classmethod
    @guarded
    def join(cls, parts: Mapping[str, Robot], poses: Mapping[str, ArrayLike | None] | None = None) -> Robot:
        """Make one robot from several, so that they are checked and planned together.

        Parameters
        ----------
        parts : mapping from str to Robot
            The robots by name. A robot's name and a slash become a prefix of the names of its links, joints, groups and
            states: "left/panda_joint1".
        poses : mapping from str to array_like, shape (4, 4), optional
            Pose of each part's root link in the world; translation in metres. A part without a pose stays where it is.

        Returns
        -------
        Robot
            Each configuration of the robot consists of the parts' configurations, one after another. Groups, states and
            disabled pairs are kept. Pairs of links from different parts are checked, unless both links are fixed to the
            world. If only some parts have disabled pairs, the adjacent pairs of the other parts are disabled, too.

        Raises
        ------
        InputError
            If there are no parts, a name is empty, or a part is not a robot.
        UnknownNameError
            If there is a pose for a part that does not exist.
        PoseError
            If a pose is not a rigid motion.

        See Also
        --------
        part : Returns one of the parts.

        Examples
        --------
        >>> arm = Robot.from_urdf("arm.urdf")
        >>> opposite = [[-1, 0, 0, 3], [0, -1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]]
        >>> both = Robot.join({"left": arm, "right": arm}, {"right": opposite})
        >>> both.configuration_names
        ('left/rail', 'left/elbow', 'right/rail', 'right/elbow')
        """
        return assembly.joined(cls, parts, poses)

    @guarded
    def disabling(self, pairs: Iterable[Pair]) -> Robot:
        """Return the same robot with more pairs of links exempt from checking, in addition to its `disabled_pairs`.

        Parameters
        ----------
        pairs : iterable of pairs of str
            Pairs of link names, for instance the pairs that `pairs_by_sampling` returns.

        Returns
        -------
        Robot

        Raises
        ------
        UnknownNameError
            If the robot has no such link.
        InputError
            If an entry is not a pair of two different links.

        Examples
        --------
        >>> sorted(Robot.from_urdf("arm.urdf").disabling([("rail", "forearm")]).disabled_pairs)
        [('forearm', 'rail')]
        """
        return replace(self, disabled_pairs=self.disabled_pairs | self.link_pairs(pairs))

    @guarded
    def swept(
        self,
        curve: Any,
        *,
        links: str | Iterable[str] | None = None,
        tolerance: float = 0.01,
        joint_error: ArrayLike = 0.0,
        scene: Scene | None = None,
        progress: Progress | None = None,
    ) -> Body:
        """Make a body that is proven to contain given links at every instant of a curve.

        Parameters
        ----------
        curve : PPoly, BPoly, BSpline, planners.Trajectory, planners.ControllerPoints, or array_like
            As for `CollisionChecker.certify_trajectory`; or a path of straight motions, shape (k, dof).
        links : str or iterable of str, optional
            Names of links with bodies, or of bodies that are attached to links in `scene`. Default: all such links and
            bodies.
        tolerance : float
            The largest distance in metres by which the body may stick out of the links' swept volume. A larger
            tolerance gives fewer pieces.
        joint_error : float, or array_like of shape (dof,)
            Largest deviation of each value from the curve [rad or m]. The body also contains the links at such
            deviations; the added space counts as sticking out.
        scene : Scene, optional
            Bodies that are attached in the scene are carried along; other bodies of the scene are ignored.
        progress : callable, optional
            Called as ``progress(done, total)`` with numbers of pieces.

        Returns
        -------
        Body
            A body of convex pieces, in the frame of the world. The attribute `Body.covering` contains the proven
            excess, `max_protrusion`: no point of the body is farther than this distance from the links' swept volume.
            The coordinates of vertices have single precision, so `Body.to_stl` writes exactly this body.

        Raises
        ------
        InputError
            As for `CollisionChecker.certify_trajectory`. Also if the tolerance is not positive and finite, cannot be
            met, or is so small that the curve would need too many poses of links.
        UnknownNameError
            If there is no such link or body.
        GeometryError
            If a link's mesh is flat.

        See Also
        --------
        CollisionChecker.certify_trajectory : Proves that a curve is free, without making a body.

        Notes
        -----
        Links are represented by their bodies (`bodies`). Each solid is cut into convex pieces that stick out by at most
        two fifths of the tolerance, if ten seconds of work suffice. docs/certified.md, "Swept volumes", derives the
        bounds.

        Examples
        --------
        >>> from loewner import Robot, collide
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> fence = robot.swept([[0.0, 0.0], [1.0, 0.0]], links="cart")
        >>> fence.covering.max_protrusion < 0.01
        True
        >>> moved = robot.forward_kinematics([0.3, 0.0])[robot.link_names.index("cart")]
        >>> collide(fence, None, robot.bodies["cart"], moved)
        True
        """
        return cast(Body, answers["swept"](self, curve, links, tolerance, joint_error, scene, progress))

    def prove_pairs(
        self,
        pairs: Iterable[Pair] | None = None,
        *,
        margin: float = 0.0,
        limits: Mapping[str, tuple[float, float]] | None = None,
        scene: Scene | None = None,
        boxes: int = 1_000_000,
        cache: bool = True,
        progress: Progress | None = None,
        proof: bool = False,
    ) -> ProvenPairs:
        """Prove which pairs of bodies can ever collide, over the whole ranges of the joints between them.

        Parameters
        ----------
        pairs : iterable of pairs of str, optional
            Names of links with bodies, or of bodies of `scene` that are attached to links of this robot or at rest. At
            least one body of each pair must move. Default: the pairs that the SRDF or the MJCF exempts from checking,
            or all pairs of links with bodies if neither has rules about pairs.
        margin : float
            Distance in metres within which bodies count as in contact; larger margins of the scene still apply.
        limits : mapping from str to (float, float), optional
            Ranges of values, keyed by their names in `configuration_names`, in radians or metres. Every other value
            ranges between the hard limits of the file. A joint without limits makes a full turn, or as many turns as
            the joints that mimic it need to return to their starting angles.
        scene : Scene, optional
            A scene with other bodies. Bodies that are attached in the scene move with the robot's links.
        boxes : int
            Largest number of boxes of configurations that are examined, for all pairs together.
        cache : bool
            If there are no `limits`, no margin and no scene, keep answers on disk, so that later calls only read them.
            The key of an answer covers everything on which the answer depends.
        progress : callable, optional
            Called as ``progress(done, total)`` with numbers of pairs.
        proof : bool
            Also write a proof of all rows that depend on joints, for other programs to verify: see `ProvenPairs.proof`.
            All rows must be NEVER, all bodies must consist of convex pieces, and all joints must turn or slide. Between
            the two bodies of a pair, at most eight values may have a range.

        Returns
        -------
        ProvenPairs
            A row for each pair, with a verdict: NEVER, ALWAYS, SOMETIMES, CAN or OPEN. See `ProvenPair`.

        Raises
        ------
        UnknownNameError
            If there is no such link, body or value.
        InputError
            If an entry is not a pair of two different bodies, neither body moves, or a link has no body. If the lower
            end of a range is above the upper end. If the robot has no collision geometry, or a body of the scene
            follows a motion. With `proof`, also if a row is not NEVER, or if the format cannot express the model or the
            proof within 5 MB.
        ConvergenceError
            With `proof`, if a pair comes so close to its margin that the format cannot express a proof.

        See Also
        --------
        loewner.pairs_by_sampling : Guesses from samples which pairs never or always collide.

        Notes
        -----
        NEVER and ALWAYS are proofs, like FREE in `CollisionChecker.certify_edges`; docs/certified.md derives the
        bounds. Planar joints need ranges for their positions, and pairs with a floating or ball joint between them are
        OPEN. The number of boxes that a pair needs grows quickly with the number of joints between its bodies; with six
        or more joints, a pair is rarely decided.

        Examples
        --------
        >>> from loewner import Robot
        >>> for row in Robot.from_urdf("arm.urdf").prove_pairs():
        ...     print(*row.names, row.verdict)
        cart forearm SOMETIMES
        cart rail NEVER
        forearm rail NEVER
        """
        terms = Terms(margin, limits, scene, boxes)
        return cast(ProvenPairs, answers["prove_pairs"](self, pairs, terms, cache, progress, proof))

    def free_range(
        self,
        joints: str | Iterable[str],
        about: ArrayLike | None = None,
        *,
        pairs: Iterable[Pair] | None = None,
        margin: float = 0.0,
        limits: Mapping[str, tuple[float, float]] | None = None,
        scene: Scene | None = None,
        boxes: int = 100_000,
    ) -> dict[str, tuple[float, float]]:
        """Find the largest ranges of joint values about a configuration in which pairs are proven not to collide.

        Parameters
        ----------
        joints : str or iterable of str
            The name of one value, or of several values, as in `configuration_names`. The range of a single value ends
            where contact begins (to within 1e-9 rad or m) or at the value's limit. The range of several values is a
            box. Every end of the box is at the same fraction of the way from the configuration to the value's limit.
        about : array_like, shape (dof,), optional
            The configuration about which the range extends; values that are not in `joints` stay fixed. Default:
            `configuration()`.
        pairs : iterable of pairs of str, optional
            As for `prove_pairs`. Default: the pairs that a `CollisionChecker` of this robot checks.
        margin, limits, scene
            As for `prove_pairs`.
        boxes : int
            Largest number of boxes that are examined each time a range of several values is tried.

        Returns
        -------
        dict
            Maps each name to the lower and the upper end [rad or m].

        Raises
        ------
        InputError
            As for `prove_pairs`; also if there are no pairs, the configuration is outside the limits, or pairs collide
            at this configuration.
        UnknownNameError
            If there is no such value, link or body.

        Examples
        --------
        >>> from loewner import Body, Robot, Scene
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> lower, upper = robot.free_range("rail", [0.0, 1.57], scene=scene)["rail"]
        >>> round(lower, 9), round(upper, 9)
        (0.0, 0.7)
        """
        terms = Terms(margin, limits, scene, boxes)
        return cast("dict[str, tuple[float, float]]", answers["free_range"](self, joints, about, pairs, terms))

    def cover(
        self,
        kind: Literal["spheres", "capsules", "boxes", "ellipsoids"] = "spheres",
        *,
        n: int | None = None,
        protrusion: float | None = None,
        progress: Progress | None = None,
    ) -> Robot:
        """Replace the body of each link with a union of simple shapes that is proven to contain it.

        Shapes that stick out of links can meet although the links never do, so that a planner may find no path. Random
        configurations reveal such pairs of links. If `prove_pairs` proves that the links of a pair never collide, the
        pair is added to `disabled_pairs`. Other pairs are still checked, and a warning lists the pairs whose shapes
        always meet.

        Parameters
        ----------
        kind : {"spheres", "capsules", "boxes", "ellipsoids"}
            As for `Body.cover`.
        n : int, optional
            The largest number of shapes for the whole robot. All links then have the same bound on how far shapes
            stick out. A cover with `n` takes several times as long to compute as a cover with ``protrusion``.
        protrusion : float, optional
            The largest distance by which shapes may stick out of a link [m]. Default: 0.02, unless `n` is given.
        progress : callable, optional
            Called as ``progress(done, total)`` with numbers of links.

        Returns
        -------
        Robot
            The same tree with other bodies. The `covering` of each body states how far the body sticks out.

        Raises
        ------
        InputError
            If `n` and ``protrusion`` are both given, the robot has no bodies, or no cover has at most `n` shapes. Also
            as for `Body.cover`.

        Warns
        -----
        UserWarning
            If the shapes of a pair that is still checked meet in all configurations that were tried.

        See Also
        --------
        save_cover : Writes the shapes for a planner.
        covered_by : Checks whether another robot's bodies contain the links.

        Examples
        --------
        >>> from loewner import Robot
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> cover = robot.cover("boxes", protrusion=0.05)
        >>> {report.outcome for report in robot.covered_by(cover).values()}
        {'covered'}
        """
        return cast("Robot", answers["cover"](self, kind, n=n, protrusion=protrusion, progress=progress))

    def covered_by(
        self, model: Robot, *, tolerance: float | None = None, progress: Progress | None = None
    ) -> dict[str, CoverReport]:
        """Prove, link by link, that another robot's bodies contain this robot's links, or find where they do not.

        Parameters
        ----------
        model : Robot
            A robot whose links have the same names and frames, such as the result of `with_cover`.
        tolerance : float, optional
            As for `Body.covered_by` [m].
        progress : callable, optional
            Called as ``progress(done, total)`` with numbers of links.

        Returns
        -------
        dict
            Maps link names to a `CoverReport`, for each link of this robot that has a body. A link without a body in
            the model is uncovered, with an infinite depth.

        Raises
        ------
        InputError
            If `model` is not a robot. Also as for `Body.covered_by`.

        Examples
        --------
        >>> from loewner import Robot
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> robot.covered_by(robot)["cart"].outcome
        'covered'
        """
        return cast("dict[str, CoverReport]", answers["covered_by"](self, model, tolerance, progress))

    def with_cover(self, path: str | os.PathLike[str], format: CoverFormat | None = None) -> Robot:
        """Return the same robot with link bodies that are read from a file, for instance a planner's spheres.

        The pairs that the file ignores replace the robot's `disabled_pairs`; a file without rules about pairs leaves
        `disabled_pairs` unchanged. docs/howto/covers.md lists the formats.

        Parameters
        ----------
        path : path
            One of the following files: a cuRobo configuration or sphere file, or an XRDF; a URDF with spheres, from
            VAMP or foam; a JSON file with spheres, for pyroki or from foam; any other URDF, with its SRDF if there is
            one with the same stem; an MJCF file; or a scene. The bodies of an MJCF file or a scene must have the names
            of the links, and the bodies of a scene must have poses in the frames of the links.
        format : str, optional
            The program for which the file was made. By default the suffix and the keys determine the format. In the
            formats "curobo", "vamp", "foam" and "pyroki", numbers are rounded to float32, as in these programs.

        Returns
        -------
        Robot

        Raises
        ------
        FileError
            If the file is missing or malformed, or has no shapes; the message names the place in the file.
        UnknownNameError
            If the file has shapes for a link that the robot does not have, or there is no such format.
        InputError
            If the suffix does not determine the format.
        MissingExtraError
            If PyYAML or MuJoCo is needed but not installed.

        Warns
        -----
        UserWarning
            If the file has spheres that are disabled or unused, or keys that are not read. If links have no shapes.

        Examples
        --------
        >>> from pathlib import Path
        >>> from loewner import Robot
        >>> ball = "[{center: [0, 0, 0], radius: 0.5}]"
        >>> text = f"collision_spheres: {{rail: {ball}, cart: {ball}, forearm: {ball}}}"
        >>> _ = Path("balls.yml").write_text(text)
        >>> Robot.from_urdf("arm.urdf").with_cover("balls.yml").bodies["cart"]
        Body(sphere, 0 vertices)
        """
        return cast("Robot", answers["with_cover"](self, path, format))

    def save_cover(self, path: str | os.PathLike[str], format: CoverFormat | None = None) -> None:
        """Write the bodies of links, and the pairs that need no check, for a planner.

        The shapes in the file contain the bodies of this robot. For programs that use float32, numbers are rounded
        outward to float32. Shapes whose angles are rounded are enlarged by 1 nm on each side. `with_cover` reads the
        file, so that `covered_by` can prove that the shapes in the file contain the links. Existing files are replaced.

        Parameters
        ----------
        path : path
        format : str, optional
            "curobo": the keys for spheres and pairs in a cuRobo configuration (.yml). "vamp" and "foam": a URDF of
            spheres, with an SRDF with the same stem. "pyroki": JSON, with ignored pairs in ``STEM.ignored.json``.
            "urdf": a URDF as from `to_urdf`, but with each capsule written as a cylinder and two spheres. "mjcf": a
            model for MuJoCo. "scene": bodies in the frames of links (.yaml). By default the suffix determines the
            format.

        Raises
        ------
        InputError
            If the format cannot express a shape, or the suffix does not determine the format. Also as for `to_urdf`.
        UnknownNameError
            If there is no such format.
        FileError
            If a file cannot be written, or its suffix belongs to another format.

        Examples
        --------
        >>> from loewner import Robot
        >>> Robot.from_urdf("arm.urdf").cover("boxes", protrusion=0.05).save_cover("boxes.urdf")
        """
        answers["save_cover"](self, path, format)

    def link_pairs(self, pairs: Iterable[Pair], name: str = "pairs") -> frozenset[Pair]:
        """Check pairs of two different links of this robot, and sort each by name.

        Parameters
        ----------
        pairs : iterable of pairs of str
        name : str
            Name of the argument in error messages.

        Returns
        -------
        frozenset of pairs of str

        Raises
        ------
        UnknownNameError
            If the robot has no such link.
        InputError
            If an entry is not a pair of two different links.
        """
        sorted_pairs, links = set(), dict.fromkeys(self.link_names)
        for pair in _validate.listed(pairs, name, wanted="pairs of names of links"):
            names = tuple(_validate.listed(pair, f"{name}, one of them", wanted="a pair of names of links"))
            if len(names) != 2:
                raise InputError(f"{name}: expected pairs of names of links, found {_validate.short(pair)} among them")
            for link in names:
                _validate.known(link, f"link in {name}", links)
            if names[0] == names[1]:
                raise InputError(f"{name}: expected two links, found {names[0]!r} twice")
            sorted_pairs.add((min(names), max(names)))
        return frozenset(sorted_pairs)

    @guarded
    def forward_kinematics(self, Q: ArrayLike) -> Floats:
        """Compute the poses of all links.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
            Configurations with entries as in `configuration_names`: radians for joints that turn, metres for joints
            that slide.

        Returns
        -------
        ndarray, shape (..., links, 4, 4)
            T_world_link, rigid up to rounding; translation in metres.

        Raises
        ------
        InputError
            If the width of Q is not dof, an entry is not finite (or beyond ±1e200), or a quaternion does not have norm
            1.

        Warns
        -----
        UserWarning
            As for `checked`.

        Examples
        --------
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> robot.forward_kinematics(robot.random_configurations(1000)).shape
        (1000, 3, 4, 4)
        """
        checked = self.checked(Q)
        batch, links = checked.shape[:-1], len(self.link_names)
        count = int(np.prod(batch))
        _validate.fits_memory(count * links * 128, f"{count} configurations of {links} links")
        return link_poses(self, checked.reshape(count, self.dof)).reshape(*batch, links, 4, 4)

    def jacobian(self, Q: ArrayLike, link: str, point: ArrayLike | None = None) -> Floats:
        """Compute the Jacobian of a point of a link with respect to the configuration.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
        link : str
        point : array_like, shape (3,), optional
            The point in the frame of the link, in metres. Default: the link's origin.

        Returns
        -------
        ndarray, shape (..., 6, dof)
            One column per value of the configuration, in the world's axes. The first three rows are the velocity of the
            point [m], and the last three rows are the angular velocity of the link [rad], both per unit of the value.

        Raises
        ------
        InputError
            As for `forward_kinematics`; also if the point is not three finite numbers.
        UnknownNameError
            If there is no such link.

        Notes
        -----
        The columns of a quaternion account only for the rotation that the quaternion represents: a change of its length
        alone does not turn the link.

        Examples
        --------
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> robot.jacobian([0.0, 0.0], robot.link_names[-1]).shape
        (6, 2)
        """
        _validate.known(link, "link in jacobian", self.link_names)
        x = np.zeros(3) if point is None else np.array(_validate.finite_array(point, "point", (3,)))
        checked = self.checked(Q)
        batch, number = checked.shape[:-1], self.link_names.index(link)
        count = math.prod(batch)
        _validate.fits_memory(count * 6 * 8 * self.dof, f"Jacobians of {count} configurations")
        flat, J = checked.reshape(count, self.dof), np.empty((count, 6, self.dof))
        in_shares(
            lambda first, last: entries.link_jacobians(*self.tree, flat, first, last, number, x, J), count, LEAST_SHARE
        )
        return J.reshape(*batch, 6, self.dof)

    @guarded
    def reach(
        self,
        link: str,
        T: ArrayLike,
        *,
        joints: str | Iterable[str] | None = None,
        start: ArrayLike | None = None,
        seeds: int = 64,
        checker: reaching.Collides | None = None,
        all: bool = False,
        tolerance: ArrayLike | None = None,
    ) -> reaching.Reached:
        """Find configurations at which a link has given poses (inverse kinematics).

        Parameters
        ----------
        link : str
        T : array_like, shape (..., 4, 4)
            The poses T_world_link, with translation in metres.
        joints : str or iterable of str, optional
            A group, or names of joints. Only these joints move. Default: all joints that move the link.
        start : array_like, shape (..., dof), optional
            Start configurations, broadcast with the poses. Joints that are not in `joints` keep their start values. The
            start is also the first seed, after being moved into the limits. The second seed is the answer for the
            previous pose, so pass the poses of a line in order. Default: `configuration()`, moved into the limits.
        seeds : int
            Number of further configurations from which to search, spread evenly within the limits; at least 1.
        checker : CollisionChecker, optional
            Look for a solution at which this checker's `CollisionChecker.collide` finds no collision.
        all : bool
            Return all distinct solutions found. If `all` is False, the search for a pose ends with the first solution.
        tolerance : array_like, shape (6,), optional
            Largest deviations to either side, in the frame of the target: three lengths along x, y and z [m], the tilts
            of the link's z axis about x and y [rad], and the spin about the z axis [rad]. ``inf`` leaves a direction
            free. ``[0, 0, 0, inf, inf, inf]`` seeks a position only, and ``[0, 0, 0, 0, 0, inf]`` a position and a z
            axis. If the tilts may be up to a and b, the z axis deviates by up to arccos(cos a + cos b - 1). Default:
            zeros.

        Returns
        -------
        Reached
            One solution for each pose, or the nearest configuration for a pose without a solution.

        Raises
        ------
        UnknownNameError
            If there is no such link, joint or group.
        PoseError
            If a pose in `T` is not a rigid motion.
        InputError
            If none of the joints moves the link, or an argument has the wrong shape or value.

        Notes
        -----
        Solutions are within the limits, except for values kept from a start outside the limits. For a pose at (x, y, z)
        in metres, solutions meet the tolerance of the position up to 1e-10 (1 + abs(x) + abs(y) + abs(z)) m. They meet
        the tolerance of the rotation up to 1e-10, measured as twice the sine of half the angle.

        A search that finds no solution does not prove that no solution exists; more seeds find more solutions. A joint
        that can turn by more than a whole turn is returned at the angle nearest to the start. Which solution comes
        first does not depend on the number of threads.

        Each seed is improved by damped Newton steps, eight seeds at a time, and is abandoned when the steps bring too
        little progress. A redundant arm has infinitely many solutions; nearly every seed finds a different solution.

        Examples
        --------
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> pose = robot.forward_kinematics([0.5, 1.0])[2]
        >>> robot.reach("forearm", pose).configuration.round(9)
        array([0.5, 1. ])
        >>> pose[0, 3] += 3.0  # the rail is too short
        >>> found = robot.reach("forearm", pose)
        >>> found.reached, found.residual.round(3)
        (False, array([1.5, 0. ]))
        """
        poses, seeds = _validate.poses(T, "T"), _validate.whole_number(seeds, "seeds", 1, reaching.MOST_SEEDS)
        limits = np.zeros(6) if tolerance is None else reaching.checked_tolerance(tolerance)
        if checker is not None and getattr(checker, "robot", None) is not self:
            raise InputError(
                f"checker: expected a loewner.CollisionChecker of this robot, found {_validate.short(checker)}"
            )
        every, chain = _validate.flag(all, "all"), chain_to(self, link, joints)
        begin = self.configuration().clip(self.lower, self.upper) if start is None else self.checked(start, "start")
        return reaching.reach(chain, poses, begin, seeds=seeds, checker=checker, every=every, tolerance=limits)

    @kept
    def _chains(self) -> dict[tuple[str, tuple[str, ...]], reaching.Chain]:
        """Chains that have been made so far, keyed by link and joints."""
        return {}

    def checked(self, Q: ArrayLike, name: str = "Q") -> Floats:
        """Check configurations and return them in the form that kernels take: C-order float64.

        Every function that takes configurations checks them with this function.

        Parameters
        ----------
        Q : array_like, shape (..., dof)
            The columns of a table with column names must be in the order of `configuration_names`.
        name : str
            Name of the argument in error messages.

        Returns
        -------
        ndarray, shape (..., dof)
            `Q` itself if it already has this form.

        Raises
        ------
        InputError
            If the width is not dof, an entry is not finite (or beyond ±1e200), or a quaternion does not have norm 1. If
            the columns of a table (such as a pandas DataFrame) have the names of joints in another order.

        Warns
        -----
        UserWarning
            Once for a robot and its copies, if a value is far outside its limits (an angle by more than a turn, or a
            length by more than a metre and ten times the range of the limits), or if a joint that turns without limits
            is outside ±50 rad. The warning names the joint, and suggests that values may be in degrees or millimetres.
        """
        # A fast path for a single configuration: a check of its few entries takes less time than NumPy's overhead.
        plain = type(Q) is np.ndarray and Q.dtype == np.float64 and Q.shape == (self.dof,) and self.runs_straight
        if plain and isinstance(Q, np.ndarray) and Q.flags.carray and self._watch.passes_one(Q.tolist()):
            return Q
        if isinstance(Q, (Mapping, str)):
            raise InputError(
                f"{name}: expected numbers, found {_validate.short(Q)}; robot.configuration(...) makes them from "
                "named values or the name of a state"
            )
        _expect_order(self, Q, name)
        array = _validate.float_array(Q, name)
        expect_width(self, array.shape, name)
        if not self._watch.passes(array):
            self._watch.expect_usable(array, name)
            self._watch.tell(array, name)
        for joint, quaternion in self._quaternions.items():
            norm = np.linalg.norm(array[..., quaternion], axis=-1)
            if np.abs(norm - 1).max(initial=0.0) > QUATERNION_TOLERANCE:
                worst = norm.flat[np.abs(norm - 1).argmax()]
                raise InputError(f"{name}: expected quaternions (wxyz) of norm 1 for {joint}, found norm {worst:g}")
        return array if array.flags.carray else array.copy()  # for Numba, a read-only array has another type

    def checked_one(self, q: ArrayLike, name: str = "q") -> Floats:
        """Check one configuration and return it in the form that kernels take.

        Parameters
        ----------
        q : array_like, shape (dof,)
        name : str
            Name of the argument in error messages.

        Returns
        -------
        ndarray, shape (dof,)
            `q` itself if it already has this form.

        Raises
        ------
        InputError
            As for `checked`, or if there is more than one configuration.
        """
        checked = self.checked(q, name)
        if checked.ndim != 1:
            shape = _validate.shape_text(checked.shape)
            raise InputError(f"{name}: expected one configuration, shape ({self.dof},), found {shape}")
        return checked

    def configuration(self, values: Mapping[str, ArrayLike] | str | None = None) -> Floats:
        """Make one configuration from named values.

        Parameters
        ----------
        values : dict or str, optional
            Values keyed by joint name or configuration name, or the name of a state. Joints without a given value are
            at 0, or at the identity quaternion, even if 0 is outside their limits.

        Returns
        -------
        ndarray, shape (dof,)

        Raises
        ------
        UnknownNameError
            If a name is unknown; the message lists the valid names.
        InputError
            If `values` is neither a mapping nor the name of a state, or a value is not a finite number.

        Examples
        --------
        >>> Robot.from_urdf("arm.urdf").configuration({"elbow": 0.5})
        array([0. , 0.5])
        """
        if isinstance(values, str):
            values = self.states[_validate.known(values, "state", self.states)][1]
        entries_by_name = _validate.mapping(values, "values", "by names of joints, or the name of a state")
        q = np.zeros(self.dof)
        for quaternion in self._quaternions.values():
            q[quaternion.start] = 1.0
        places = {name: slice(i, i + 1) for i, name in enumerate(self.configuration_names)} | self._columns
        for name, value in entries_by_name.items():
            if name in self.mimics:
                followed, _ = self.mimics[name]
                raise UnknownNameError(
                    f"joint: expected one with a value of its own, found {name!r}: {name} mimics {followed}; "
                    f"set {followed!r}"
                )
            at = places[_validate.known(name, "joint", places)]
            numbers = np.atleast_1d(_validate.float_array(value, name))
            q[at] = _validate.finite_array(numbers, name, (at.stop - at.start,))
        return self.checked(q, "values")

    @guarded
    def random_configurations(self, n: int, seed: int = 0) -> Floats:
        """Draw n configurations uniformly within the limits, shape (n, dof).

        A value without limits is drawn from -π .. π (even a length, in metres); quaternions are uniform. For a value
        with one limit, the range begins at the limit. This range is 2π wide, or wider if it would otherwise not reach
        the far end of -π .. π. A limit outside ±1e6 does not set the range, but is still respected.

        Parameters
        ----------
        n : int
        seed : int
            `n` and `seed` must not be negative.

        Returns
        -------
        ndarray, shape (n, dof)

        Raises
        ------
        InputError
            If `n` or `seed` is not a non-negative integer, or n configurations do not fit into memory.

        Examples
        --------
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> Q = robot.random_configurations(1000)
        >>> Q.shape, bool((Q[:, 0] >= 0).all() and (Q[:, 0] <= 2).all())
        ((1000, 2), True)
        """
        n = _validate.whole_number(n, "n", 0)
        _validate.fits_memory(n * self.dof * 8, f"{n} configurations")
        rng = np.random.default_rng(_validate.whole_number(seed, "seed", 0))
        lower, upper = self.usual_range(np.pi)
        Q = rng.uniform(lower, upper, (n, self.dof)).clip(lower, upper)
        for quaternion in self._quaternions.values():
            drawn = rng.normal(size=(n, 4))
            Q[:, quaternion] = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
        return Q

    @guarded
    def usual_range(self, reach: float) -> tuple[Floats, Floats]:
        """Return finite limits for a search, each of shape (dof,), within `lower` and `upper`.

        Parameters
        ----------
        reach : float
            Replaces a missing limit, or a limit outside ±1e6, which some programs write for "no limit". The new limit
            is at distance `reach` from 0 or, if that is farther out, at twice this distance from the value's other
            limit.

        Returns
        -------
        lower, upper : ndarray, shape (dof,)
            In radians or metres.

        Examples
        --------
        >>> Robot.from_urdf("arm.urdf").usual_range(3.0)
        (array([ 0., -3.]), array([2., 3.]))
        """
        reach = _validate.positive_scalar(reach, "reach")
        if reach > FARTHEST_LIMIT:
            raise InputError(f"reach: expected at most {FARTHEST_LIMIT:g}, found {reach:g}")
        below, above = self.lower > -FARTHEST_LIMIT, self.upper < FARTHEST_LIMIT
        lower = np.where(below, self.lower, np.minimum(-reach, np.where(above, self.upper, 0.0) - 2 * reach * above))
        upper = np.where(above, self.upper, np.maximum(reach, lower + 2 * reach))
        return np.maximum(lower, self.lower), np.minimum(upper, self.upper)

    @guarded
    def distances(self, Q0: ArrayLike, Q1: ArrayLike) -> OneOrMany:
        """Compute Euclidean distances between configurations, in the units of the joints.

        The difference between two orientations is the angle between them.

        Parameters
        ----------
        Q0, Q1 : array_like, shape (..., dof)
            Broadcast together.

        Returns
        -------
        float, or ndarray, shape (...)

        Examples
        --------
        >>> Robot.from_urdf("arm.urdf").distances([0, 0], [[3, 4], [0, 1]])
        array([5., 1.])
        """
        a, b = self.checked(Q0, "Q0"), self.checked(Q1, "Q1")
        _validate.broadcast({"Q0": a.shape[:-1], "Q1": b.shape[:-1]})
        return self._distances(a, b)

    def _distances(self, a: Floats, b: Floats) -> OneOrMany:
        if a.ndim == b.ndim == 1 and self.runs_straight:
            return math.dist(a.tolist(), b.tolist())
        with np.errstate(over="ignore"):
            squares = np.square(b - a)
            for quaternion in self._quaternions.values():
                # Half the chord to the nearer of q and -q is the sine of a quarter of the angle.
                p, q = np.broadcast_arrays(a[..., quaternion], b[..., quaternion])
                chord = np.minimum(np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1))
                squares[..., quaternion] = 0.0
                squares[..., quaternion.start] = power(4 * _elementary.arcsin(np.minimum(chord / 2, 1.0)), 2)
            return np.sqrt(squares.sum(axis=-1))

    @kept
    def runs_straight(self) -> bool:
        """Whether all values change linearly along motions, that is, whether no joint has a quaternion."""
        return not self._quaternions

    def between(self, Q0: ArrayLike, Q1: ArrayLike, t: ArrayLike) -> Floats:
        """Compute configurations along a motion: values change linearly, and orientations follow the shorter arc.

        Parameters
        ----------
        Q0, Q1 : array_like, shape (..., dof)
        t : array_like, shape (...)
            Fraction of the motion, from 0 at Q0 to 1 at Q1; broadcast with the configurations.

        Returns
        -------
        ndarray, shape (..., dof)

        Examples
        --------
        >>> Robot.from_urdf("arm.urdf").between([0, 0], [1, 2], [0.0, 0.5, 1.0])
        array([[0. , 0. ],
               [0.5, 1. ],
               [1. , 2. ]])
        """
        a, b = self.checked(Q0, "Q0"), self.checked(Q1, "Q1")
        at = _validate.finite_array(t, "t", ("...",))[..., None]
        _validate.broadcast({"Q0": a.shape[:-1], "Q1": b.shape[:-1], "t": at.shape[:-1]})
        return interpolated(self, a, b, at)

    @kept
    def _quaternions(self) -> dict[str, slice]:
        """Columns of the quaternion of each joint that has one."""
        widths = {len(VALUES[kind]) for kind in WITH_QUATERNION}
        return {
            joint: slice(at.stop - 4, at.stop) for joint, at in self._columns.items() if at.stop - at.start in widths
        }


def named_joints(robot: Robot, joints: str | Iterable[str] | None) -> list[str]:
    """Return the names of a group's joints, of the given joints or of all joints; refuse an empty list."""
    if isinstance(joints, str):
        _validate.known(joints, "joints", (*robot.groups, *robot.joint_names))
        names = list(robot.groups.get(joints, (joints,)))
    else:
        names = list(robot.joint_names) if joints is None else _validate.listed(joints, "joints")
    if not names:
        raise InputError(
            "joints: expected one or more, found none" + (f" in group {joints!r}" if isinstance(joints, str) else "")
        )
    return [_validate.known(name, "joints", robot.joint_names) for name in names]


def chain_to(robot: Robot, link: str, joints: str | Iterable[str] | None = None) -> reaching.Chain:
    """Check the arguments of `Robot.reach` that name a link and joints, and return the chain of joints to the link."""
    _validate.known(link, "link", robot.link_names)
    moving = named_joints(robot, joints)
    key = link, tuple(moving)
    if key not in robot._chains:
        moves = np.zeros(robot.dof, dtype=bool)
        for joint in moving:
            moves[robot._columns[joint]] = True
        limits, usual = np.stack([robot.lower, robot.upper]), np.stack(robot.usual_range(np.pi))
        chain = reaching.chain(robot.tree, robot.link_names.index(link), moves, limits, usual)
        if not chain.moving.any():
            raise InputError(f"link: expected one that the joints move ({', '.join(moving)}), found {link!r}")
        robot._chains[key] = chain
    return robot._chains[key]


def _expect_order(robot: Robot, Q: object, name: str) -> None:
    """Refuse a table, or a row of one, whose labels are joints in another order; an array would lose the labels."""
    labels = getattr(Q, "columns" if hasattr(Q, "columns") else "index", None)
    if labels is None or callable(labels) or isinstance(Q, np.ndarray):
        return
    column_names, expected = [str(label) for label in labels], list(robot.configuration_names)
    if column_names != expected and set(column_names) & set(expected):
        raise InputError(
            f"{name}: expected columns in the order {_validate.short(', '.join(expected))}, found "
            f"{_validate.short(', '.join(column_names))}; choose them by list(robot.configuration_names)"
        )


def expect_width(robot: Robot, shape: tuple[int, ...], name: str) -> None:
    """Refuse configurations whose shape is not (..., dof)."""
    if not shape or shape[-1] != robot.dof:
        raise InputError(
            f"{name}: expected shape (..., {robot.dof}), one column each for {', '.join(robot.configuration_names)}; "
            f"found {_validate.shape_text(shape)}"
        )


def exported_rates(robot: Robot, rates: Floats) -> Floats:
    """Convert rates of a robot's values to the order of the robot's model; see `Robot.exported`."""
    if not robot.runs_straight or len(robot._known_layout.turning):
        raise InputError("robot: expected joints of one value each, found quaternions, or cosines and sines")
    return robot._known_layout.exported_rates(rates)


def joints_above(robot: Robot) -> tuple[str, ...]:
    """Return the name of the joint above each link, in the order of the links; an empty string if there is none."""
    return tuple(robot._above.get(link, ("", None))[0] for link in robot.link_names)


def scene_of(robot: Robot, poses: Mapping[str, Floats]) -> Scene:
    """Make a scene of a robot's bodies, at the given poses or at the origin; pairs that need no check may touch."""
    scene = Scene()
    for link, body in robot.bodies.items():
        scene.add(link, body, poses.get(link))
    for pair in skipped_with_bodies(robot):
        scene.allow(*pair)
    return scene


def skipped_with_bodies(robot: Robot) -> list[Pair]:
    """Return the pairs of links with bodies that a checker of this robot does not check by default, sorted."""
    return sorted(pair for pair in robot._usually_skipped if robot.bodies.keys() >= set(pair))


def sources_of(robot: Robot) -> tuple[Source, ...]:
    """Return the sources from which a robot and its parts were read."""
    return robot._sources


def link_poses(robot: Robot, Q: Floats) -> Floats:
    """Compute the poses of all links at checked configurations, shape (N, links, 4, 4)."""
    total, links = len(Q), len(robot.link_names)
    out = np.empty((total, links, 4, 4))
    in_shares(lambda first, last: entries.link_poses(*robot.tree, Q, first, last, out), total, LEAST_SHARE)
    return out


def interpolated(robot: Robot, a: Floats, b: Floats, at: Floats) -> Floats:
    """Interpolate between checked configurations as in `Robot.between`; fractions have a final axis of length 1."""
    Q = np.where(at == 1, b, a + at * (b - a))  # the sum may differ from b by a rounding error
    for quaternion in robot._quaternions.values():
        p = a[..., quaternion]
        q, cosine = _nearer(p, b[..., quaternion])
        angle = _elementary.arccos(np.minimum(cosine, 1.0))
        # For a small angle, the chord is as long as the arc.
        sine = np.maximum(_elementary.sin(angle), 1e-12)
        straight = angle < 1e-6
        of_p = np.where(straight, 1 - at, _elementary.sin((1 - at) * angle) / sine)
        of_q = np.where(straight, at, _elementary.sin(at * angle) / sine)
        mixed = of_p * p + of_q * q
        Q[..., quaternion] = mixed / lengths(mixed)[..., None]
    return np.ascontiguousarray(Q)


def on_the_way(robot: Robot, a: Floats, b: Floats) -> Floats:
    """Return the ends b with the quaternion signs that `between` uses; at half a turn, rounding decides the sign."""
    if robot.runs_straight:
        return b
    ends = b.copy()
    for quaternion in robot._quaternions.values():
        ends[..., quaternion], _ = _nearer(a[..., quaternion], b[..., quaternion])
    return ends


def unlimited(robot: Robot) -> tuple[Bools, Bools, Bools]:
    """Mark the columns without a lower limit, the columns without an upper limit, and angles without any limit.

    Some programs write 1e16 or the largest number for "no limit"; such values count as no limit.
    """
    below, above = robot.lower <= -FARTHEST_LIMIT, robot.upper >= FARTHEST_LIMIT
    tree, turning = robot.tree, reaching.wrapping(robot.tree, robot.dof)
    turning[tree.column[tree.kind == kernel_columns.PLANAR] + 2] = False  # planners move only joints with one value
    return below, above, turning & below & above


def _ends(
    robot: Description, columns: Mapping[str, slice], dof: int, of: Callable[[Joint], tuple[float, float]]
) -> tuple[Floats, Floats]:
    """Return the least and the largest configuration values from the ranges of joints."""
    lower, upper = np.full(dof, -np.inf), np.full(dof, np.inf)
    for name, column in columns.items():
        joint = robot.joints[name]
        lower[column], upper[column] = of(joint)
        if joint.bounds is not None:
            first = slice(column.start, column.start + len(joint.bounds[0]))
            lower[first], upper[first] = joint.bounds
        if joint.kind in WITH_QUATERNION:
            lower[column.stop - 4 : column.stop], upper[column.stop - 4 : column.stop] = -1.0, 1.0
    return lower, upper


def _rates(robot: Description, columns: Mapping[str, slice], dof: int, kind: str) -> Floats:
    """Compute the largest rates of one kind of configuration values; NaN if a rate is unlimited or not given."""
    rates = np.full(dof, np.nan)
    for joint in robot.joints.values():
        moved, multiplier = (joint.name, 1.0) if joint.mimic is None else (joint.mimic.joint, joint.mimic.multiplier)
        if moved in columns and multiplier != 0:
            at = columns[moved]
            rates[at] = np.fmin(rates[at], getattr(joint, kind) / abs(multiplier))
    return rates


def _nearer(p: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Return q or -q, namely the quaternion that is nearer to p, and the cosine of its angle to p."""
    cosine = dot(p, q)[..., None]
    return np.where(cosine < 0, -q, q), np.abs(cosine)


def first_shown(robot: Robot) -> tuple[str | None, Floats]:
    """Return the name of the state with the most joints, and its configuration with values moved into the limits.

    If there is no state, return None, and zeros moved into the limits.
    """
    state = max(robot.states, key=lambda name: len(robot.states[name][1]), default=None)
    return state, np.clip(robot.configuration(state), robot.lower, robot.upper)


def drawn(robot: Robot) -> tuple[list[Shape], dict[str, Floats], str]:
    """Return the shapes of links, their poses and a note, for the configuration that a picture shows first."""
    state, q = first_shown(robot)
    poses = dict(zip(robot.link_names, robot.forward_kinematics(q), strict=True))
    shapes = [
        for_pictures(packed_of(body), len(robot.bodies) > MANY_LINKS).at(poses[name], LINKS[k % len(LINKS)])
        for k, (name, body) in enumerate(robot.bodies.items())
    ]
    return shapes, poses, f", at the state {state!r}" if state else ", at zero or the nearest limits"
