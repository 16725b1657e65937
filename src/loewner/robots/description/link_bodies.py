"""Make the bodies of links from the collision shapes of a URDF; bodies of meshes are cached on disk."""

from __future__ import annotations

import filecmp
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Final, Literal, get_args

import numpy as np

from loewner._base._files import read_regular
from loewner._base._log import log
from loewner._base._matrices import image
from loewner._base._plausible import LARGEST_MESH_RADIUS, LARGEST_RADIUS, doubt_about_size, warn
from loewner._base._validate import Floats, Progress
from loewner._kernels import _sources
from loewner._kernels.columns import OUTER_CENTER, OUTER_RADIUS
from loewner.bodies import Body, packed_of
from loewner.errors import ConvergenceError, FileError, InputError
from loewner.meshes import decomposition as meshes
from loewner.meshes import files as mesh_files
from loewner.meshes.coverage import Covering
from loewner.robots.description.link_meshes import described, mesh_body, warn_of_open_meshes
from loewner.robots.description.urdf import Description, Shape

# glTF files may keep their points in other files, so their own bytes do not determine their content.
NOT_CACHED = (".gltf", ".glb")

# Representations of a link's mesh, and the default. "hull" means the convex hull, "pieces" means convex pieces, and
# "surface" means the triangles. For "auto", `link_meshes.hull_or_solid` chooses between the hull and the solid that the
# mesh encloses.
MeshModel = Literal["hull", "pieces", "surface", "auto"]
MODELS: tuple[MeshModel, ...] = get_args(MeshModel)
USUAL_MODEL: Final = "auto"

# Folders and modules, besides the kernels, with the code that makes a body from a mesh file.
_MAKERS = (
    "_base", "meshes", "ellipsoids", "bodies", "robots/description/link_bodies.py", "robots/description/link_meshes.py",
)  # fmt: skip

PRIMITIVES: dict[str, Callable[..., Body]] = {
    "box": lambda *size: Body.box(size),
    "sphere": Body.sphere,
    "cylinder": Body.cylinder,
    "capsule": Body.capsule,
}


def link_bodies(
    robot: Description,
    package_dirs: Sequence[Path],
    *,
    model: str,
    tol: float,
    cache: bool,
    progress: Progress,
) -> tuple[dict[str, Body], dict[str, tuple[str, ...]]]:
    """Make one body for each link that has collision shapes, in the frame of the link.

    Parameters
    ----------
    robot : Description
    package_dirs : sequence of path
        Folders that contain packages, or the folders of the packages themselves.
    model : str
        Representation of meshes, one of `MODELS`.
    tol : float
        As for `Body.from_mesh`.
    cache : bool
        Whether to keep the fits of meshes on disk and reuse them.
    progress : callable
        Called as ``progress(done, total)`` after each shape.

    Returns
    -------
    bodies : dict
        The body of each link.
    shapes : dict
        Descriptions of the bodies that represent each link's collision shapes.

    Raises
    ------
    FileError
        If a mesh cannot be found or read (the message names the link and the places searched), or one of `package_dirs`
        is not a folder.
    GeometryError
        If a mesh is flat or empty.

    Warns
    -----
    UserWarning
        Once, if a body is probably not in metres. With "auto", also if meshes are not closed; one warning names all
        open meshes.
    """
    for folder in package_dirs:
        if not os.path.isdir(folder):
            raise FileError(f"{folder}: expected a folder of packages, found no such folder")

    def fit(file: Path, shape: Shape) -> Body:
        return (_kept_body if cache else _mesh_body)(file, shape, model, tol)

    shapes = [(link, shape) for link, own in robot.shapes.items() for shape in own]
    parts_of, words_of = {link: list[Body]() for link, _ in shapes}, {link: list[str]() for link, _ in shapes}
    for done, (link, shape) in enumerate(shapes, 1):
        part = _body(shape, link, robot.path, package_dirs, fit)
        parts_of[link].append(part)
        words_of[link].append(described(part) if shape.kind == "mesh" else shape.kind)
        progress(done, len(shapes))
    if model == "auto":
        for link, words in words_of.items():
            log.info("%s, link %r: %s", robot.path, link, "; ".join(words))
        names = (f"{PurePosixPath(shape.file_name).name} of {link!r}" for link, shape in shapes)
        named = zip(names, chain.from_iterable(words_of.values()), strict=True)
        warn_of_open_meshes(robot.path, named, "meshes='surface' (--model surface)")
    for (link, shape), part in zip(shapes, chain.from_iterable(parts_of.values()), strict=True):
        if doubt := _doubt(shape, part):
            warn(f"{robot.path}, link {link!r}: expected {doubt}")
            break
    bodies = {link: own[0] if len(own) == 1 else _union(own) for link, own in parts_of.items()}
    return bodies, {link: tuple(words) for link, words in words_of.items()}


def _doubt(shape: Shape, body: Body) -> str:
    """Return a reason to doubt that the body of a shape is in metres; usually empty."""
    rows = packed_of(body).kernel.table
    if not len(rows):
        return ""
    centers = rows[:, OUTER_CENTER : OUTER_CENTER + 3]
    radius = rows[:, OUTER_RADIUS].max() + np.ptp(centers, axis=0).max() / 2
    largest = LARGEST_MESH_RADIUS if shape.kind == "mesh" else LARGEST_RADIUS
    return doubt_about_size(float(radius), float(np.abs(centers).max()), largest)


def _body(shape: Shape, link: str, urdf: Path, folders: Sequence[Path], fit: Callable[[Path, Shape], Body]) -> Body:
    """Make the body of a shape, with `fit` if it is a mesh; errors name the URDF, the line, the link and the file."""
    file = mesh_file(shape, link, urdf, folders) if shape.kind == "mesh" else None
    try:
        return primitive(shape) if file is None else fit(file, shape)
    except (FileError, InputError, ConvergenceError) as error:
        text = str(error) if file is None or str(file) in str(error) else f"{file}: {error}"
        raise type(error)(f"{urdf}, line {shape.line}, link {link!r}: {text}") from None


def _kept_body(file: Path, shape: Shape, model: str, tol: float) -> Body:
    """Load the body of a mesh from the cache on disk, or make the body and add it to the cache."""
    if file.suffix.lower() in NOT_CACHED or not _sources.source_hash():
        return _mesh_body(file, shape, model, tol)
    key = _key(file, shape, model, tol)
    kept = _sources.cache_folder() / "bodies" / f"{key}.npz"
    with suppress(FileError):  # missing or damaged
        return Body.load(kept)
    body = _mesh_body(file, shape, model, tol)
    if _key(file, shape, model, tol) != key:  # the file has changed, and the body may come from either version
        return body
    with suppress(OSError):  # a cache that cannot be written is no error
        kept.parent.mkdir(parents=True, exist_ok=True)
        body.save(kept)
    return body


def primitive(shape: Shape) -> Body:
    """Make the body of a shape other than a mesh, at its pose in the link."""
    body = PRIMITIVES[shape.kind](*shape.sizes)
    return body if np.array_equal(shape.origin, np.eye(4)) else body.transformed(shape.origin)


def placed_mesh(file: Path, shape: Shape) -> tuple[Floats, meshes.Triangles]:
    """Return the vertices and triangles of a mesh, at its pose in the link."""
    vertices, triangles = meshes.load(file)
    if shape.scale.prod() < 0:  # a mirrored mesh would otherwise be inside out
        triangles = triangles[:, ::-1]
    return image(shape.origin[:3, :3], vertices * shape.scale) + shape.origin[:3, 3], triangles


def _mesh_body(file: Path, shape: Shape, model: str, tol: float) -> Body:
    return mesh_body(placed_mesh(file, shape), model, tol)


@cache
def _code() -> str:
    """Hash the code that makes bodies, so that bodies made by a different, perhaps faulty, version are not reused."""
    home = Path(meshes.__file__).parents[1]
    return hash_of_code(home / maker for maker in _MAKERS)


def hash_of_code(places: Iterable[Path]) -> str:
    """Hash the kernels, and the Python modules at the given places: files, or folders with all their contents."""
    import hashlib  # hashlib loads OpenSSL, which only robots with meshes need

    digest = hashlib.sha256((_sources.source_hash() or "").encode())
    for place in places:
        for path in sorted(place.rglob("*.py")) or [place]:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _key(file: Path, shape: Shape, model: str, tol: float) -> str:
    """Hash everything that determines a fit: the contents of the file, pose, options of the fit, and code."""
    import hashlib

    digest = hashlib.sha256(repr((_code(), file.suffix.lower(), model, tol)).encode())
    digest.update(np.concatenate([shape.scale, shape.origin.ravel()]).tobytes())
    digest.update(read_regular(file, "a mesh file", mesh_files.LIMIT))
    return digest.hexdigest()[:32]


def _union(parts: list[Body]) -> Body:
    """Unite the bodies of a link's shapes, and combine the coverings of the meshes."""
    body = Body.union(parts)
    coverings = [part.covering for part in parts if part.covering is not None]
    if not coverings:
        return body
    return Body(
        packed_of(body),
        Covering(
            kind=coverings[0].kind if len({c.kind for c in coverings}) == 1 else "decomposition",
            exact=all(c.exact for c in coverings),
            max_uncovered=max(c.max_uncovered for c in coverings),
            excess_volume=float("nan"),
            samples=sum(c.samples for c in coverings),
            # A piece that sticks out of its own mesh may lie inside another mesh; the bound is still valid.
            max_protrusion=float(np.max([c.max_protrusion for c in coverings])),  # NaN if one is unknown
        ),
    )


# -- files --------------------------------------------------------------------------------------


def mesh_file(shape: Shape, link: str, urdf: Path, folders: Sequence[str | os.PathLike[str]]) -> Path:
    """Find the mesh file that a URDF names for a shape of a link."""
    homes = _homes(urdf)
    looked = list(dict.fromkeys(_candidates(shape.file_name, homes, folders)))
    for path in looked:
        if os.path.isfile(path):  # Path.is_file raises if a name is too long or invalid
            _expect_one(shape, link, urdf, [_candidates(shape.file_name, [home], folders) for home in homes])
            return path
    expected = f"{urdf}, line {shape.line}: expected the mesh {shape.file_name!r} of link {link!r}"
    for path in filter(os.path.exists, looked):
        raise FileError(f"{expected}, found {path}, which is no regular file")
    raise FileError(f"{expected}, but there is no such file; {_told(looked)}")


def package_folder(package: str, urdf: Path, folders: Sequence[str | os.PathLike[str]]) -> Path:
    """Find the folder of a package that a robot's description names."""
    looked = list(dict.fromkeys(_candidates(f"package://{package}/", _homes(urdf), folders)))
    for path in looked:
        if os.path.isdir(path):
            return path
    raise FileError(f"{urdf}: expected the package {package!r}, but there is no such folder; {_told(looked)}")


def _told(looked: Sequence[Path]) -> str:
    places = ", ".join(map(str, looked)) or "no place"
    return f"looked at {places}. Other folders of packages can be given (package_dirs, --package-dir)"


def _homes(urdf: Path) -> list[Path]:
    """Return the folder of a URDF; if the file is a symbolic link, the folders of the link and of its target."""
    target = Path(os.path.realpath(urdf)).parent
    return [urdf.absolute().parent, target] if os.path.islink(urdf) else [target]


def _expect_one(shape: Shape, link: str, urdf: Path, places: Iterable[Iterable[Path]]) -> None:
    """Refuse a mesh name that means one file next to a symbolic link to a URDF, and another next to its target."""
    paths = [path for path in (next(filter(os.path.isfile, listed), None) for listed in places) if path is not None]
    if len(paths) == 2 and not filecmp.cmp(paths[0], paths[1], shallow=False):
        raise FileError(
            f"{urdf}, line {shape.line}: expected one mesh {shape.file_name!r} of link {link!r}, found two that "
            f"differ: {paths[0]} beside the symbolic link, and {paths[1]} beside its target"
        )


def _candidates(name: str, homes: Sequence[Path], folders: Sequence[str | os.PathLike[str]]) -> Iterator[Path]:
    """List the places where a mesh may be: the given packages, ROS's packages, then the URDF's parent folders."""
    scheme, separator, rest = name.rpartition("://")
    package_folders = [Path(folder) for folder in folders]
    if separator and scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        above = (folder for home in homes for folder in (home, *home.parents))
        for folder in (*package_folders, *_ros_folders(), *above):
            yield folder / package / inside
            if folder.name == package:
                yield folder / inside
    elif not separator or scheme == "file":
        for folder in (*homes, *package_folders):
            yield folder / rest  # an absolute path is kept


def _ros_folders() -> Iterator[Path]:
    """List the package folders of a sourced ROS workspace."""
    for variable, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for entry in os.environ.get(variable, "").split(os.pathsep):
            if entry:
                yield Path(entry) / below
