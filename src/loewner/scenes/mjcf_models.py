"""Read bodies, joints and contacts of an MJCF file from the model that MuJoCo compiles.

The format is complicated (defaults, includes, frames, replicas, composites). MuJoCo therefore reads the file, and this
module reads the model that MuJoCo makes. Robots and scenes are made from the result.
"""

from __future__ import annotations

import os
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from loewner._base import _validate
from loewner._base._plausible import warn
from loewner._base._rotations import from_quaternion, pose_of
from loewner._base._validate import Bools, Floats, Ints, Pair
from loewner.bodies import Body
from loewner.errors import ConvergenceError, FileError, InputError, imported
from loewner.scenes.mjcf_limits import check_limits

# In MuJoCo, a plane is a half-space. A cube replaces the half-space; its upper face is centered at the plane's center.
# The cube's edge [m] is the longest that causes no warning about units.
PLANE_EDGE = 1000.0

# Limit on the number of pairs of parts of a model, far above the number in any real model.
MOST_PAIRS = 2**22


class MjcfJoint(NamedTuple):
    """A joint of a body.

    A body may have several joints, which act one after another.

    Attributes
    ----------
    name : str
    kind : str
        "hinge", "slide", "ball" or "free".
    anchor, axis : ndarray, shape (3,)
        Anchor and axis in the frame of the joint's body; the axis has unit length.
    lower, upper : float
        Limits of a hinge [rad] or a slide [m]; infinite for a joint without limits, and for a ball or free joint.
    reference : float
        Value of the joint at which the body has the pose stated in the file: the attribute `ref`.
    mimic : tuple, optional
        The name of the joint that this joint follows, a multiplier and an offset; None unless equalities are read and
        an equality in the file couples the two joints.
    """

    name: str
    kind: str
    anchor: Floats
    axis: Floats
    lower: float
    upper: float
    reference: float
    mimic: tuple[str, float, float] | None


class MjcfBody(NamedTuple):
    """A body, with its pose in the frame of its parent.

    The world is the first body, and is its own parent.

    Attributes
    ----------
    name : str
    parent : int
    T_parent_body : ndarray, shape (4, 4)
        Pose in the frame of the parent, with the body's joints at their references.
    joints : tuple of MjcfJoint
    parts : dict
        Maps the name of each part to a `Body` in the frame of this body. A part consists of the geoms that collide with
        the same geoms of other bodies. The first part has the name of the body; in the world, each part has the name of
        its only geom.
    T_world_body : ndarray, shape (4, 4)
        Pose in the world, with all joints at their references.
    """

    name: str
    parent: int
    T_parent_body: Floats
    joints: tuple[MjcfJoint, ...]
    parts: dict[str, Body]
    T_world_body: Floats


class MjcfModel(NamedTuple):
    """The contents of a whole file.

    Attributes
    ----------
    name : str
    path : Path
    bodies : tuple of MjcfBody
        In MuJoCo's order, with parents before children.
    related_pairs : frozenset
        Pairs of parts, as sorted names, that MuJoCo skips because the parts are rigidly joined, or belong to a parent
        and its child.
    excluded_pairs : frozenset
        Pairs that MuJoCo skips because of <exclude>, contype or conaffinity in the file.
    keyframes : dict
        Maps the name of a keyframe to its qpos.
    """

    name: str
    path: Path
    bodies: tuple[MjcfBody, ...]
    related_pairs: frozenset[Pair]
    excluded_pairs: frozenset[Pair]
    keyframes: dict[str, Floats]


def read_mjcf(path: str | os.PathLike[str], tol: float) -> MjcfModel:
    """Read an MJCF file.

    Parameters
    ----------
    path : path
    tol : float
        Upper limit on the certified log-volume gap of every fit to a mesh.

    Raises
    ------
    FileError
        If the file does not exist, or MuJoCo cannot compile it.
    InputError
        If a colliding geom is a signed distance field, which is not supported.
    GeometryError
        If a colliding mesh is flat.
    MissingExtraError
        If MuJoCo is not installed.

    Warns
    -----
    UserWarning
        If the file contains elements that change MuJoCo's motions or contacts but are not read: flexible bodies,
        constraints, margins of geoms, and all limits except the limits of hinges and slides. One warning lists all such
        elements.
    """
    file = _validate.path(path, "path", wanted="a path to an MJCF file")
    return compiled_model(_compiled(file), None, file, tol, couplings=False)


def compiled_model(model: Any, data: Any, file: Path, tol: float, *, couplings: bool) -> MjcfModel:
    """Read a compiled model; see `read_mjcf`.

    Parameters
    ----------
    model : mujoco.MjModel
    data : mujoco.MjData, optional
        Supplies the poses of mocap bodies, and determines which constraints are active; by default, the model does
        both.
    file : Path
        The file's path, for messages and names.
    tol : float
    couplings : bool
        Whether to read equalities, by which a joint follows another joint.
    """
    mujoco = _mujoco()
    names = _Names(model)
    active = np.asarray(model.eq_active0 if data is None else data.eq_active) != 0
    mimics = _couplings(mujoco, model, names, active) if couplings else {}
    unread = _unread(mujoco, model)
    if couplings:
        unread["constraints (equality)"] = int(np.count_nonzero(active)) - len(mimics)
    unread_parts = [f"{count} {what}" for what, count in unread.items() if count]
    if unread_parts:
        warn(f"{file}: not read, although MuJoCo computes with it: {', '.join(unread_parts)}")
    members = _members(model)
    part_names = {geoms: names.of_part(body, number, geoms) for body in range(model.nbody)
                  for number, geoms in enumerate(members[body])}  # fmt: skip
    placed = _placed(mujoco, model, data)
    bodies = tuple(
        MjcfBody(
            name=names.bodies[body],
            parent=int(model.body_parentid[body]),
            T_parent_body=_in_parent(model, data, body),
            joints=tuple(
                _joint(model, names, int(model.body_jntadr[body]) + k, mimics)  # in the order in which joints act
                for k in range(int(model.body_jntnum[body]))
            ),
            parts={
                part_names[geoms]: _union([_geom_body(mujoco, model, names, geom, file, tol) for geom in geoms])
                for geoms in members[body]
            },
            T_world_body=placed[body],
        )
        for body in range(model.nbody)
    )
    related, excluded = _left_out(mujoco, model, part_names, file)
    return MjcfModel(
        name=name_of(model) or file.stem,
        path=file,
        bodies=bodies,
        related_pairs=related,
        excluded_pairs=excluded,
        keyframes=dict(zip(names.keys, map(np.array, model.key_qpos), strict=True)),
    )


def name_of(model: Any) -> str:
    """Return the name of a compiled model."""
    return str(model.names[: model.names.index(b"\0")], "utf-8")


def _mujoco() -> Any:
    """Return the MuJoCo module."""
    return imported("mujoco", "MJCF files need MuJoCo", "mujoco")


def _compiled(file: Path) -> Any:
    """Return MuJoCo's compiled model of the file."""
    mujoco = _mujoco()
    if check_limits(file) == "robot":
        warn(
            f"{file}: expected an MJCF file, found a URDF, of which MuJoCo reads neither <mimic> nor velocities; "
            "Robot.from_urdf reads them"
        )
    try:
        return mujoco.MjModel.from_xml_path(os.fspath(file))
    except Exception as error:  # usually a ValueError, but MuJoCo's own code or a lack of memory may raise others
        reason = " ".join(str(error).split())
        raise FileError(f"{file}: expected an MJCF file, found a file that MuJoCo refuses ({reason})") from None


def _unread(mujoco: Any, model: Any) -> dict[str, int]:
    """Count the elements of a model that affect motions or contacts in MuJoCo but are not read."""
    colliding = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    balls = model.jnt_type == mujoco.mjtJoint.mjJNT_BALL
    mocap = np.flatnonzero(model.body_mocapid >= 0)
    places = model.key_mpos.reshape(model.nkey, model.nmocap, 3)[:, model.body_mocapid[mocap]]
    turns = model.key_mquat.reshape(model.nkey, model.nmocap, 4)[:, model.body_mocapid[mocap]]
    elsewhere = (places != model.body_pos[mocap]).any(axis=2) | (turns != model.body_quat[mocap]).any(axis=2)
    return {
        "flexible bodies": model.nflex,
        "constraints (equality)": model.neq,
        "limits of tendons": int(np.count_nonzero(model.tendon_limited)),
        "limits of ball joints": int(np.count_nonzero(balls & (model.jnt_limited != 0))),
        "limits of position actuators within those of their joints": _narrower(mujoco, model),
        "margins of geoms": int(np.count_nonzero(colliding & (model.geom_margin > 0))),
        "margins of pairs": int(np.count_nonzero(model.pair_margin > 0)),
        "poses of mocap bodies in keyframes": int(np.count_nonzero(elsewhere)),
    }


def _narrower(mujoco: Any, model: Any) -> int:
    """Count the actuators that hold a joint at the value of a control whose range is narrower than the joint's."""
    joint = model.actuator_trnid[:, 0]
    holds = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_ctrllimited != 0)
    holds &= (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) & (model.actuator_gear[:, 0] == 1)
    holds &= (model.actuator_gainprm[:, 0] != 0) & (model.actuator_gainprm[:, 0] == -model.actuator_biasprm[:, 1])
    at = np.flatnonzero(holds)
    lower, upper = model.actuator_ctrlrange[at].T
    limited = model.jnt_limited[joint[at]] != 0
    within = (lower > model.jnt_range[joint[at], 0]) | (upper < model.jnt_range[joint[at], 1])
    return int(np.count_nonzero(~limited | within))


class _Names:
    """Names of bodies, joints, geoms and keyframes, unique within a kind; kind and index replace a missing name."""

    def __init__(self, model: Any) -> None:
        self.bodies = _named([model.body(i).name for i in range(model.nbody)], "body")
        self.joints = _named([model.jnt(i).name for i in range(model.njnt)], "joint")
        self.geoms = _named([model.geom(i).name for i in range(model.ngeom)], "geom")
        self.keys = _named([model.key(i).name for i in range(model.nkey)], "key")
        self._parts = set(self.bodies)

    def of_part(self, body: int, number: int, geoms: tuple[int, ...]) -> str:
        """Return a part's unique name.

        The first part of a body has the body's name. Each further part has the name BODY/GEOM, where GEOM is its first
        geom. In the world, a part has the name of its geom.
        """
        if body and not number:
            return self.bodies[body]
        name = self.geoms[geoms[0]] if not body else f"{self.bodies[body]}/{self.geoms[geoms[0]]}"
        while name in self._parts:
            name += "_geom"
        self._parts.add(name)
        return name


def _named(names: list[str], kind: str) -> list[str]:
    """Return the names, with new names in place of empty names."""
    taken = set(names)
    return [name or _validate.unused(f"{kind}{number}", taken) for number, name in enumerate(names)]


def _placed(mujoco: Any, model: Any, data: Any) -> list[Floats]:
    """Compute the world poses of all bodies, with joints at their references."""
    state = mujoco.MjData(model)
    if data is not None:
        state.mocap_pos[:], state.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    mujoco.mj_kinematics(model, state)
    return [_pose(state.xpos[body], state.xquat[body]) for body in range(model.nbody)]


def _in_parent(model: Any, data: Any, body: int) -> Floats:
    """Return the pose of a body in the frame of its parent; for a mocap body, `data` has the pose."""
    mocap = int(model.body_mocapid[body])
    if data is None or mocap < 0:
        return _pose(model.body_pos[body], model.body_quat[body])
    return _pose(data.mocap_pos[mocap], data.mocap_quat[mocap] / np.linalg.norm(data.mocap_quat[mocap]))


def _pose(position: Floats, wxyz: Floats) -> Floats:
    return pose_of(from_quaternion(wxyz.tolist(), "quat"), position)


def _couplings(mujoco: Any, model: Any, names: _Names, active: Bools) -> dict[int, tuple[str, float, float]]:
    """Return the joints that follow another joint linearly because of an active equality, keyed by index.

    MuJoCo's equality is y - y0 = c0 + c1 (x - x0) + ..., where y0 and x0 are the joints' references.
    """
    followed: dict[int, int] = {}
    mimics = {}
    for k in np.flatnonzero(active & (model.eq_type == mujoco.mjtEq.mjEQ_JOINT)).tolist():
        y, x, (c0, c1, *more) = int(model.eq_obj1id[k]), int(model.eq_obj2id[k]), model.eq_data[k, :5].tolist()
        end = x
        while end in followed:
            end = followed[end]
        if x < 0 or any(more) or y in followed or end == y:
            continue
        y0, x0 = (float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (y, x))
        followed[y] = x
        mimics[y] = names.joints[x], c1, y0 + c0 - c1 * x0
    return mimics


def _joint(model: Any, names: _Names, joint: int, mimics: dict[int, tuple[str, float, float]]) -> MjcfJoint:
    kind = ("free", "ball", "slide", "hinge")[int(model.jnt_type[joint])]
    single = kind in ("slide", "hinge")
    lower, upper = (-np.inf, np.inf) if not (single and model.jnt_limited[joint]) else model.jnt_range[joint].tolist()
    return MjcfJoint(
        name=names.joints[joint],
        kind=kind,
        anchor=np.array(model.jnt_pos[joint]),
        axis=np.array(model.jnt_axis[joint]),
        lower=lower,
        upper=upper,
        reference=float(model.qpos0[model.jnt_qposadr[joint]]) if single else 0.0,
        mimic=mimics.get(joint),
    )


# -- geoms ------------------------------------------------------------------------------------------


def _members(model: Any) -> list[list[tuple[int, ...]]]:
    """List the geoms of each part of each body, in the order of the file; geoms that never collide are left out.

    Geoms of a body that collide with the same geoms form one part. A geom of the world, or a geom that is named by a
    <pair>, forms its own part.
    """
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    parts: list[dict[tuple[int, ...], list[int]]] = [{} for _ in range(model.nbody)]
    for geom in range(model.ngeom):
        body, mask = int(model.geom_bodyid[geom]), (int(model.geom_contype[geom]), int(model.geom_conaffinity[geom]))
        if any(mask) or geom in paired:
            alone = body == 0 or geom in paired
            parts[body].setdefault((*mask, geom if alone else -1), []).append(geom)
    return [list(map(tuple, of_body.values())) for of_body in parts]


def _union(bodies: list[Body]) -> Body:
    return bodies[0] if len(bodies) == 1 else Body.union(bodies)


def _geom_body(mujoco: Any, model: Any, names: _Names, geom: int, file: Path, tol: float) -> Body:
    """Make the body of a geom, in the frame of its MuJoCo body."""
    try:
        shape = _shape(mujoco.mjtGeom, model, geom, tol)
        T_body_geom = _pose(model.geom_pos[geom], model.geom_quat[geom])
        return shape if np.array_equal(T_body_geom, np.eye(4)) else shape.transformed(T_body_geom)
    except (InputError, ConvergenceError) as error:
        raise type(error)(f"{file}, geom {names.geoms[geom]!r}: {error}") from None


def _shape(kinds: Any, model: Any, geom: int, tol: float) -> Body:
    """Make the body of a geom, in the geom's frame; MuJoCo's sizes are radii, half lengths and semi-axes."""
    kind, (x, y, z) = int(model.geom_type[geom]), model.geom_size[geom].tolist()
    if kind == kinds.mjGEOM_SPHERE:
        return Body.sphere(x)
    if kind == kinds.mjGEOM_CAPSULE:
        return Body.capsule(x, 2 * y)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return Body.ellipsoid([x, y, z])
    if kind == kinds.mjGEOM_CYLINDER:
        return Body.cylinder(x, 2 * y)
    if kind == kinds.mjGEOM_BOX:
        return Body.box([2 * x, 2 * y, 2 * z])
    if kind == kinds.mjGEOM_MESH:
        return Body.from_points(_hull_points(model, int(model.geom_dataid[geom])), tol=tol)
    if kind == kinds.mjGEOM_PLANE:
        return Body.box([PLANE_EDGE] * 3).transformed(pose_of(np.eye(3), [0.0, 0.0, -PLANE_EDGE / 2]))
    if kind == kinds.mjGEOM_HFIELD:
        return _terrain(model, int(model.geom_dataid[geom]))
    raise InputError(
        "expected a sphere, capsule, ellipsoid, cylinder, box, plane, mesh or height field, found a signed distance "
        "field; disable it (contype='0' conaffinity='0'), and add a mesh of it to a scene by Body.from_surface"
    )


def _terrain(model: Any, field: int) -> Body:
    """Make a height field whose grid is centered at the origin.

    In MuJoCo's data, rows run along y, columns run along x, and heights are between 0 and 1.
    """
    rows, columns, first = (int(a[field]) for a in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
    half_x, half_y, highest, below = model.hfield_size[field].tolist()
    shares = np.array(model.hfield_data[first : first + rows * columns], dtype=np.float64).reshape(rows, columns)
    spacing = [2 * half_x / (columns - 1), 2 * half_y / (rows - 1)]
    field_at_corner = Body.height_field(highest * shares.T, spacing, base=-below)
    return field_at_corner.transformed(pose_of(np.eye(3), [-half_x, -half_y, 0.0]))


def _hull_points(model: Any, mesh: int) -> Floats:
    """Return the vertices of the convex hull that MuJoCo uses for a mesh; `maxhullvert` may limit their number."""
    first, count, graph = (int(a[mesh]) for a in (model.mesh_vertadr, model.mesh_vertnum, model.mesh_graphadr))
    vertices = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
    if graph < 0:
        return vertices
    on_hull = int(model.mesh_graph[graph])
    start = graph + 2 + on_hull  # after the numbers of vertices and faces, and the position of each vertex's edges
    used: Ints = model.mesh_graph[start : start + on_hull]
    return vertices[used]


# -- pairs that MuJoCo does not check ------------------------------------------------------------------


def _left_out(
    mujoco: Any, model: Any, part_names: dict[tuple[int, ...], str], file: Path
) -> tuple[frozenset[Pair], frozenset[Pair]]:
    """Find the pairs of parts that MuJoCo skips: parts of related bodies, and pairs that the file excludes.

    The section "Collision" of MuJoCo's documentation gives the rules.
    """
    parts = list(part_names)
    if len(parts) * (len(parts) - 1) // 2 > MOST_PAIRS:
        raise InputError(f"{file}: expected at most {MOST_PAIRS} pairs of parts that collide, found {len(parts)} parts")
    together = {frozenset(pair) for pair in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)}
    excluded = {frozenset(divmod(int(signature), 1 << 16)) for signature in model.exclude_signature}
    parents_meet = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    kinds, wanted = model.geom_contype, model.geom_conaffinity
    related_pairs, excluded_pairs = set(), set()
    for a, b in combinations(parts, 2):
        names = part_names[a], part_names[b]
        pair = min(names), max(names)
        if frozenset((a[0], b[0])) in together:
            continue
        bodies = int(model.geom_bodyid[a[0]]), int(model.geom_bodyid[b[0]])
        if _related(model, *bodies, parents_meet):
            related_pairs.add(pair)
        elif frozenset(bodies) in excluded or not (kinds[a[0]] & wanted[b[0]] or kinds[b[0]] & wanted[a[0]]):
            excluded_pairs.add(pair)
    return frozenset(related_pairs), frozenset(excluded_pairs)


def _related(model: Any, a: int, b: int, parents_meet: bool) -> bool:
    """Return whether two bodies are rigidly joined, or are parent and child; the world does not count as a parent."""
    a, b = int(model.body_weldid[a]), int(model.body_weldid[b])
    if a == b:
        return True
    if parents_meet or not (a and b):
        return False
    above_a, above_b = (int(model.body_weldid[model.body_parentid[body]]) for body in (a, b))
    return above_a == b or above_b == a
