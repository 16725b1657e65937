"""Draws front.png: an arm that is proven free by outer ellipsoids, and one that is proven to collide by inner ones.

python docs/images/front.py [FOLDER]     needs the packages of requirements/dev.txt and data.txt, and Pillow

The links are rastered into a depth buffer, and the ellipsoids are intersected with the line of sight of each pixel.
"""

import sys
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
from matplotlib.font_manager import FontProperties, findfont
from PIL import Image, ImageDraw, ImageFilter, ImageFont
from scipy.cluster.vq import kmeans2, vq

import loewner
from loewner import Body
from loewner.viewer.drawing import pieces
from loewner.viewer.visuals import visual_meshes

# Size of one of the two panes [pixels], and of a pixel [m]; each pixel is drawn as FINER x FINER smaller ones.
WIDTH, HEIGHT, LABEL, PIXEL, FINER, COLOURS = 620, 580, 112, 1.06 / 620, 2, 255
MIDDLE = np.array([0.36, 0.02, 0.36])  # what is in the middle of a pane [m]

# Towards the viewer, to the right and up in the picture; and towards the light.
TOWARDS = np.array([0.52, -0.8, 0.34]) / np.linalg.norm([0.52, -0.8, 0.34])
RIGHT = np.cross([0.0, 0.0, 1.0], TOWARDS) / np.linalg.norm(TOWARDS[:2])
VIEW = np.array([RIGHT, np.cross(TOWARDS, RIGHT), TOWARDS])
LIGHT = np.array([-0.35, 0.62, 0.7])

DOWN = np.array([-0.2, 0.25, -1.0])  # towards the shadows

LINK, OBSTACLE, SHELL, GREEN = (205, 214, 224), (230, 176, 84), (40, 160, 90), (28, 120, 64)
RED, STEEL, BRASS = (190, 36, 54), (70, 110, 160), (190, 130, 40)

POSTURES = {
    "FREE": {"panda_joint1": 0.05, "panda_joint2": -0.2, "panda_joint4": -1.9, "panda_joint6": 1.8},
    "COLLIDING": {"panda_joint1": 0.05, "panda_joint2": 0.3, "panda_joint4": -2.1, "panda_joint6": 1.9},
}
LABELS = {"FREE": ("outer ellipsoids are apart", GREEN), "COLLIDING": ("inner ellipsoids overlap", RED)}


def panda() -> loewner.Robot:
    """The arm of example-robot-data."""
    folder = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
    urdf, srdf = (folder / f"panda_description/{name}" for name in ("urdf/panda.urdf", "srdf/panda.srdf"))
    return loewner.Robot.from_urdf(urdf, srdf=srdf, package_dirs=[folder.parents[1]])


def obstacles() -> loewner.Scene:
    """A box, a ball and a post."""
    scene = loewner.Scene()
    for name, body, at in (
        ("box", Body.box([0.2, 0.22, 0.24]), [0.56, 0.02, 0.12]),
        ("ball", Body.sphere(0.09), [0.4, -0.34, 0.09]),
        ("post", Body.cylinder(0.05, 0.5), [0.6, 0.485, 0.25]),
    ):
        T = np.eye(4)
        T[:3, 3] = at
        scene.add(name, body, T)
    return scene


def rastered(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the nearest triangle (n, 3, 3) at each small pixel, -inf if there is none, and its number."""
    columns, rows = WIDTH * FINER, HEIGHT * FINER
    size = np.ptp(triangles[..., :2], axis=1).max(axis=1)
    keys = np.full(rows * columns, -1, dtype=np.int64)
    for steps in np.unique(counts := np.maximum(2, np.ceil(1.5 * size).astype(int) + 1)):
        chosen = np.flatnonzero(counts == steps)
        a, b = (x.ravel() for x in np.meshgrid(*2 * [np.linspace(0.0, 1.0, steps)]))
        weights = np.stack([1 - a - b, a, b], axis=1)[a + b <= 1 + 1e-9]
        for part in np.array_split(chosen, 1 + len(chosen) * len(weights) // 2_000_000):
            points = np.einsum("wk,nkd->nwd", weights, triangles[part])
            x, y = (points[..., k].astype(np.int64) for k in (0, 1))
            seen = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
            depth = ((points[..., 2] + 4000) * 1e5).astype(np.int64)
            key = depth << 24 | np.broadcast_to(part[:, None], depth.shape)
            np.maximum.at(keys, (y * columns + x)[seen], key[seen])
    keys = keys.reshape(rows, columns)
    return np.where(keys >= 0, (keys >> 24) / 1e5 - 4000, -np.inf), np.where(keys >= 0, keys & (1 << 24) - 1, 0)


def in_picture(points: np.ndarray) -> np.ndarray:
    """Columns, rows and depths of points, in small pixels."""
    seen = (points - MIDDLE) @ VIEW.T * (FINER / PIXEL)
    return seen * [1, -1, 1] + [WIDTH * FINER / 2, HEIGHT * FINER / 2, 0]


def ellipsoid(center: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the near side at each small pixel, nan outside, and its normals."""
    c, F = in_picture(center), VIEW @ factor * (FINER / PIXEL) * np.array([[1], [-1], [1]])
    M = np.linalg.inv(F @ F.T)
    x, y = np.meshgrid(np.arange(WIDTH * FINER) + 0.5 - c[0], np.arange(HEIGHT * FINER) + 0.5 - c[1])
    half = M[2, 0] * x + M[2, 1] * y
    rest = M[0, 0] * x * x + 2 * M[0, 1] * x * y + M[1, 1] * y * y - 1
    with np.errstate(invalid="ignore"):
        root = np.sqrt(half**2 - M[2, 2] * rest)
    near = (root - half) / M[2, 2]
    normals = np.stack([M[k, 0] * x + M[k, 1] * y + M[k, 2] * near for k in range(3)], axis=-1)
    return near + c[2], normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def over(image: np.ndarray, colour: np.ndarray | tuple[int, int, int], alpha: np.ndarray) -> None:
    """Lay a colour over an image (rows, columns, 4) whose colours are multiplied by its opacity."""
    image *= 1 - alpha[..., None]
    image[..., :3] += alpha[..., None] * np.asarray(colour)
    image[..., 3] += alpha


def shaded(colour: np.ndarray | tuple[int, int, int], normals: np.ndarray) -> np.ndarray:
    """Colour of surfaces with these normals in the picture, whose y points down."""
    light = normals @ (LIGHT * [1, -1, 1] / np.linalg.norm(LIGHT))
    return np.asarray(colour) * (0.7 + 0.36 * np.clip(light, -0.3, 1.0))[..., None]


def shadow(image: np.ndarray, triangles: np.ndarray) -> None:
    """Draw the shadow on the floor, with a soft edge."""
    fallen = triangles - triangles[..., 2:] * (DOWN / DOWN[2])
    depth, _ = rastered(in_picture(fallen))
    soft = Image.fromarray(np.uint8(255 * np.isfinite(depth))).filter(ImageFilter.GaussianBlur(5 * FINER))
    over(image, (30, 40, 55), 0.3 * np.asarray(soft) / 255)


def pane(verdict: str) -> Image.Image:
    """One arm among the obstacles, with the ellipsoids that prove its verdict."""
    robot, scene = panda(), obstacles()
    q = robot.configuration({"panda_joint7": 0.785, "panda_finger_joint1": 0.03, **POSTURES[verdict]})
    frames = dict(zip(robot.link_names, robot.forward_kinematics(q), strict=True))
    things = [(body, frames[name]) for name, body in robot.bodies.items()]
    around = [(scene.static_bodies[k], scene.static_poses[k]) for k in range(len(scene.static_names))]
    touching = proven(verdict, things, around)

    arm = [place(mesh, frames[name]) for name, mesh in visual_meshes(robot)[0].items()]
    rest = [place(pieces(b), T) for b, T in around]
    triangles, colours = np.concatenate(arm + rest), [LINK] * sum(map(len, arm)) + [OBSTACLE] * sum(map(len, rest))
    image = np.zeros((HEIGHT * FINER, WIDTH * FINER, 4))
    shadow(image, triangles)
    seen = in_picture(triangles)
    depth, number = rastered(seen)
    normals = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    normals *= np.where(normals[:, 2:] < 0, -1, 1)
    surface = shaded(np.array(colours)[number], normals[number])
    which = "outer" if verdict == "FREE" else "inner"
    shells = [
        (ellipsoid(c, F), RED if id(body) in touching else SHELL if verdict == "FREE" else own)
        for own, pairs in ((STEEL, things), (BRASS, around))
        for body, T in pairs
        for c, F in zip(*placed(getattr(body, which), T), strict=True)
    ]
    if verdict == "FREE":
        over(image, surface, np.isfinite(depth).astype(float))
        for (near, normal), colour in sorted(shells, key=lambda shell: np.nanmean(shell[0][0])):
            rim = 0.1 + 0.75 * (1 - normal[..., 2]) ** 2
            over(image, colour, np.where(near > depth - FINER, np.nan_to_num(rim), 0.0))
    else:
        nearest = np.full(depth.shape, -np.inf)
        for (near, normal), colour in shells:
            front = near > nearest
            nearest[front] = near[front]
            over(image, np.nan_to_num(shaded(colour, normal)), front.astype(float))
        over(image, surface, np.where(np.isfinite(depth) & (depth > nearest + FINER), 0.42, 0.0))
    small = image.reshape(HEIGHT, FINER, WIDTH, FINER, 4).mean(axis=(1, 3))
    small[..., :3] /= np.maximum(small[..., 3:], 1e-9)
    small[..., 3] *= 255
    return Image.fromarray(small.clip(0, 255).astype(np.uint8), "RGBA")


def place(mesh: tuple[np.ndarray, np.ndarray], T: np.ndarray) -> np.ndarray:
    """Triangles (n, 3, 3) of a mesh at a pose."""
    return (np.asarray(mesh[0]) @ T[:3, :3].T + T[:3, 3])[np.asarray(mesh[1])]


def placed(ellipsoids: loewner.Ellipsoids, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centers and factors of ellipsoids at a pose."""
    return ellipsoids.center @ T[:3, :3].T + T[:3, 3], T[:3, :3] @ ellipsoids.factor


def proven(verdict: str, links: list, around: list) -> set[int]:
    """Bodies whose ellipsoids prove a collision, by `id`; refuse a picture that does not show what its label says."""
    touching: set[int] = set()
    for link, T in links:
        for body, at in around:
            outer, inner = (overlap(which, link, T, body, at) for which in ("outer", "inner"))
            assert verdict == "COLLIDING" or not outer
            if inner:
                touching |= {id(link), id(body)}
    assert bool(touching) == (verdict == "COLLIDING")
    return touching


def overlap(which: str, a: Body, T_a: np.ndarray, b: Body, T_b: np.ndarray) -> bool:
    """Whether an ellipsoid of one body overlaps one of the other."""
    A, B = getattr(a, which).transformed(T_a), getattr(b, which).transformed(T_b)
    return any(np.ravel(loewner.overlap(A[i], B)).any() for i in range(A.batch_shape[0]))


def main(folder: Path) -> None:
    """Write the picture into a folder."""
    picture = Image.new("RGBA", (2 * WIDTH, HEIGHT + LABEL))
    draw = ImageDraw.Draw(picture)
    fonts = [
        ImageFont.truetype(findfont(FontProperties(family="DejaVu Sans", weight=weight)), size)
        for weight, size in (("bold", 46), ("regular", 38))
    ]
    for k, (verdict, (why, colour)) in enumerate(LABELS.items()):
        picture.paste(pane(verdict), (k * WIDTH, 0))
        left, top = k * WIDTH + 12, HEIGHT - 4
        draw.rounded_rectangle((left, top, left + WIDTH - 24, HEIGHT + LABEL - 2), 18, fill=colour)
        for text, font, y in ((verdict, fonts[0], top + 32), (why, fonts[1], top + 82)):
            draw.text((left + WIDTH / 2 - 12, y), text, fill="white", font=font, anchor="mm")
    in_few_colours(picture).save(folder / "front.png", optimize=True)


def in_few_colours(picture: Image.Image) -> Image.Image:
    """The picture with a palette of the colours, opacity included, that are nearest to its own."""
    pixels = np.asarray(picture, dtype=float).reshape(-1, 4)
    pixels[pixels[:, 3] == 0] = 0
    drawn = pixels[pixels[:, 3] > 0]
    few, _ = kmeans2(drawn[:: 1 + len(drawn) // 40_000], COLOURS - 1, minit="++", rng=0)
    labels = [(*colour, 255) for _, colour in LABELS.values()]
    palette = np.concatenate([np.zeros((1, 4)), labels, few[2:]]).round()
    number, _ = vq(pixels, palette)
    made = Image.fromarray(number.reshape(picture.height, picture.width).astype(np.uint8), "P")
    made.putpalette(palette[:, :3].astype(np.uint8).tobytes())
    made.info["transparency"] = palette[:, 3].astype(np.uint8).tobytes()
    return made


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
