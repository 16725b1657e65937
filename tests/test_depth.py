"""Depth images: their points, the space that rays have passed, and the robot's own points."""

from contextlib import nullcontext

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from loewner import Body, CollisionChecker, GeometryError, InputError, PoseError, Scene, collide
from loewner.bodies import checksum_of
from loewner.depth import SeenSpace, points_of
from mechanisms import ball, box, joint, link, robot
from sampling import examples

K = np.array([[40.0, 0.5, 15.5], [0, 42.0, 11.5], [0, 0, 1]])


def at(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def turned(seed=0):
    """A pose of a camera."""
    T = np.eye(4)
    T[:3, :3] = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).uniform(size=3))[:3, :3]
    T[:3, 3] = 0.3, -0.2, 0.5
    return T


def same(a, b):
    """Whether two bodies have the same arrays."""
    return checksum_of(a) == checksum_of(b)


def arm():
    return robot(
        link("base", box((0.2, 0.2, 0.1))),
        link("upper", box((0.6, 0.1, 0.1), (0.3, 0.0, 0.0))),
        link("fore", ball(0.08, (0.4, 0.0, 0.0)), box((0.4, 0.06, 0.06), (0.2, 0.0, 0.0))),
        joint("shoulder", "revolute", "base", "upper", limits=(-3, 3)),
        joint("elbow", "revolute", "upper", "fore", (0.6, 0, 0), limits=(-3, 3)),
    )


# -- points ---------------------------------------------------------------------------------------


def test_points_project_onto_their_pixels():
    """The points of an image lie at its depths, on the rays of their pixels."""
    rng, T = np.random.default_rng(1), turned()
    image = rng.uniform(0.5, 2.0, (24, 32))
    image[3, 4], image[5, 6], image[7, 8] = np.nan, np.inf, 0.0
    points = points_of(image, K, T)
    gone = ~np.isfinite(points).all(axis=-1)
    assert np.argwhere(gone).tolist() == [[3, 4], [5, 6], [7, 8]]
    local = (points - T[:3, 3]) @ T[:3, :3]
    pixels = local @ K.T
    v, u = np.indices(image.shape)
    assert (pixels[..., :2] / local[..., 2:])[~gone] == pytest.approx(np.stack([u, v], axis=-1)[~gone])
    assert local[..., 2][~gone] == pytest.approx(image[~gone])


def test_bodies_of_images_are_clouds_of_their_points():
    """One call makes the body of the finite points; with a checker, of those that are not on the robot."""
    rng, T, q = np.random.default_rng(5), turned(), [0.2, -0.4]
    T[:3, 3] = -T[:3, 2]
    image = rng.uniform(0.5, 1.5, (24, 32))
    image[0, 0], image[1, 1], image[2, 2] = np.nan, np.inf, -1.0
    checker = CollisionChecker(arm())
    points = points_of(image, K, T)
    for size in ({"radius": 0.02}, {"voxel": 0.05}):
        wanted = Body.from_cloud(points[np.isfinite(points[..., 0])], **size)
        assert same(Body.from_depth(image, K, T, **size), wanted)
        others = checker.off_the_robot(points, q, clear=0.1)
        assert 0 < len(others) < np.isfinite(points[..., 0]).sum()
        assert same(
            Body.from_depth(image, K, T, **size, checker=checker, q=q, clear=0.1), Body.from_cloud(others, **size)
        )


def test_single_precision_images_are_read():
    """Cameras give float32; the points are those of the same numbers in double precision."""
    image = np.random.default_rng(6).uniform(0.5, 1.5, (24, 32)).astype(np.float32)
    assert same(Body.from_depth(image, K, radius=0.02), Body.from_depth(image.astype(float), K, radius=0.02))


# -- the robot's own points -----------------------------------------------------------------------


@examples(2, 8)
@given(st.integers(0, 10_000), st.floats(0.005, 0.2))
def test_the_points_that_stay_are_those_beyond(seed, clear):
    """A naive loop over all links and points gives the same answer, and so does a ball around each point."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(arm())
    q = rng.uniform(-3, 3, 2)
    points = rng.uniform(-1.2, 1.2, (80, 3)) * [1, 1, 0.3]
    stays = checker.off_the_robot(points, q, clear=clear, mask=True)
    poses = checker.robot.forward_kinematics(q)
    for point, stay in zip(points, stays, strict=True):
        touched = [
            collide(Body.sphere(clear), at(*point), body, poses[checker.robot.link_names.index(name)])
            for name, body in checker.robot.bodies.items()
        ]
        assert stay != any(touched)


def test_points_of_the_robots_surface_go():
    """No point on a link stays, with noise below `clear`, and what is carried goes with the robot."""
    rng = np.random.default_rng(2)
    scene = Scene()
    scene.add("can", Body.cylinder(0.04, 0.2))
    checker = CollisionChecker(arm(), scene)
    scene.attach("can", "fore", at(0.55, 0.0, 0.0))
    q = np.array([0.4, -1.0])
    poses = checker.robot.forward_kinematics(q)
    placed = [(checker.robot.bodies["upper"], poses[1]), (scene["can"], poses[2] @ at(0.55, 0.0, 0.0))]
    for body, T in placed:
        mesh = trimesh.util.concatenate([body.to_trimesh()])
        points = trimesh.sample.sample_surface(mesh, 500, seed=3)[0] @ T[:3, :3].T + T[:3, 3]
        noisy = points + rng.uniform(-0.005, 0.005, points.shape)
        assert len(checker.off_the_robot(noisy, q, clear=0.02)) == 0
    far = np.array([[2.0, 2.0, 2.0]])
    assert checker.off_the_robot(far, q).tolist() == far.tolist()


def test_bodies_that_follow_motions_go_at_their_time():
    """A body on a motion keeps its points unless a time is given, and then loses them where it is."""
    scene = Scene()
    scene.add("cart", Body.box([0.2, 0.2, 0.2]))
    scene.follow("cart", [0.0, 1.0], [at(2, 0, 0), at(2, 1, 0)])
    checker = CollisionChecker(arm(), scene)
    points = np.array([[2.0, 0.0, 0.0], [2.0, 1.0, 0.0]])
    kept = {t: checker.off_the_robot(points, [0, 0], time=t, mask=True).tolist() for t in (None, 0.0, 1.0)}
    assert kept == {None: [True, True], 0.0: [False, True], 1.0: [True, False]}


def test_organised_clouds_keep_their_shape():
    """A cloud of shape (H, W, 3) has a mask of shape (H, W), and numbers that are not finite are dropped."""
    points = np.full((4, 5, 3), 3.0)
    points[0, 0], points[1, 1, 2] = 0.0, np.inf
    checker = CollisionChecker(arm())
    stays = checker.off_the_robot(points, [0, 0], mask=True)
    assert stays.shape == (4, 5)
    assert np.argwhere(~stays).tolist() == [[0, 0], [1, 1]]
    assert checker.off_the_robot(points.astype(np.float32), [0, 0]).shape == (18, 3)


# -- seen space -----------------------------------------------------------------------------------


def visible(point, image, T):
    """Whether a point is in front of the pixel in which it appears."""
    x, y, z = (point - T[:3, 3]) @ T[:3, :3]
    if z <= 0:
        return False
    u, v, _ = K @ [x / z, y / z, 1.0]
    row, column = round(v), round(u)
    inside = 0 <= row < image.shape[0] and 0 <= column < image.shape[1]
    return inside and image[row, column] > z


@examples(12, 30)
@given(st.integers(0, 10_000))
def test_all_points_of_seen_cells_are_visible(seed):
    """Random points of each cell that is seen are in front of the depth of their pixel, with random images."""
    rng, T = np.random.default_rng(seed), turned(seed)
    image = np.repeat(np.repeat(rng.uniform(0.3, 2.5, (6, 8)), 4, axis=0), 4, axis=1)
    image[rng.uniform(size=image.shape) < 0.02] = np.nan
    center = T[:3, :3] @ [0.0, 0.0, 1.0] + T[:3, 3]
    space = SeenSpace(center - 0.6, (24, 24, 24), 0.05)
    space.see(image, K, T)
    seen = np.argwhere(space.age == 0)
    assert len(seen) > 0
    for cell in seen[rng.integers(len(seen), size=50)]:
        for point in space.centers[tuple(cell)] + rng.uniform(-0.025, 0.025, (10, 3)):
            assert visible(point, image, T)


def test_a_naive_loop_finds_the_same_cells():
    """Cells are seen if all pixels of the box about their corners are deeper than the farthest corner."""
    rng, T = np.random.default_rng(4), turned(4)
    image = rng.uniform(0.8, 2.5, (24, 32))
    center = T[:3, :3] @ [0.0, 0.0, 1.0] + T[:3, 3]
    space = SeenSpace(center - 0.5, (10, 10, 10), 0.1)
    space.see(image, K, T)
    for cell in np.ndindex(10, 10, 10):
        corners = space.centers[cell] + 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        local = (corners - T[:3, 3]) @ T[:3, :3]
        u, v, _ = K @ (local / local[:, 2:]).T
        low, high = np.floor([v.min(), u.min()]).astype(int), np.ceil([v.max(), u.max()]).astype(int)
        fits = local[:, 2].min() > 0 and (low >= 0).all() and (high < image.shape).all()
        part = image[low[0] : high[0] + 1, low[1] : high[1] + 1]
        assert (space.age[cell] == 0) == (fits and part.min() > local[:, 2].max())


def test_memory_of_frames():
    """Seen cells stay seen, age with each image, and are forgotten on request."""
    space = SeenSpace([-0.5, -0.5, 0.5], (10, 10, 10), 0.1)
    near, far = np.full((24, 32), 0.8), np.full((24, 32), 1.4)
    space.see(far, K)
    before = space.age.copy()
    assert set(np.unique(before)) == {-1, 0}
    space.see(near, K)
    assert (space.age >= 0).sum() == (before >= 0).sum()
    assert space.age.max() == 1
    space.forget(0)
    assert 0 < (space.age >= 0).sum() < (before >= 0).sum()


def test_images_come_in_the_order_of_their_times():
    """An image that is older than the last one is refused and changes nothing; equal times are two cameras."""
    space, image = SeenSpace([-0.5, -0.5, 0.5], (10, 10, 10), 0.1), np.full((24, 32), 1.4)
    for time in (2.0, None, 2.0, 2.5):
        space.see(image, K, time=time)
    before = space.age.copy()
    with pytest.raises(InputError, match=r"time: expected 2\.5 s, the time of the last image, or more, found 2\.25"):
        space.see(image, K, time=2.25)
    assert (space.age == before).all()
    assert space.time == 2.5


def test_the_robot_can_leave_its_own_cells():
    """Unknown cells collide with a robot in them; without those at the robot, it is free, and the others stay."""
    checker = CollisionChecker(arm())
    space = SeenSpace([-1.5, -1.5, -0.3], (60, 60, 12), 0.05)
    q = np.array([0.3, 0.9])
    for body, collides in ((space.body(), True), (space.body(checker, q, clear=0.01), False)):
        scene = Scene()
        scene.add("unknown", body)
        around = CollisionChecker(checker.robot, scene)
        assert around.collide(q) == collides
        assert around.collide([-2.0, 0.0])
    with pytest.raises(InputError, match="checker, q: expected both or none"):
        space.body(checker)


def test_space_outside_the_grid_is_closed():
    """The body has a layer of cells around the grid, unless the caller leaves it open."""
    space = SeenSpace([-0.5, -0.5, 0.5], (4, 4, 4), 0.25)
    space.age[:] = 0
    ball = Body.sphere(0.01)
    places = np.stack([at(0, 0, 1.0), at(0, 0, 1.6), at(-0.6, 0, 1.0), at(0.6, 0.6, 0.4), at(0, 0, 2.0)])
    assert collide(space.body(), None, ball, places).tolist() == [False, True, True, True, False]
    with pytest.raises(GeometryError, match="occupied"):
        space.body(closed=False)


def test_depths_in_millimetres_cause_a_warning():
    """Floats in millimetres would make cells behind things seen."""
    with pytest.warns(UserWarning, match="are they in millimetres"):
        points_of(np.full((24, 32), 1500.0), K)


@pytest.mark.parametrize("matrix", [K / [[32], [24], [1]], np.linalg.inv(K)], ids=["normalised", "inverse"])
def test_matrices_of_other_conventions_cause_a_warning(matrix):
    """A normalised matrix, or the inverse one, would make a camera that sees nearly a half-space."""
    with pytest.warns(UserWarning, match="of 640 x 480 pixels wider than 170 degrees; is the matrix normalised"):
        points_of(np.ones((480, 640)), matrix)


@pytest.mark.parametrize(
    ("shape", "cx", "doubt"),
    [((24, 32), 31.5, None), ((24, 32), 32.0, "outside an image of 32 x 24"), ((32, 24), 15.5, "is it transposed")],
)
def test_principal_points_of_other_images_cause_a_warning(shape, cx, doubt):
    """A matrix for another resolution has its middle outside; one for a turned image has it elsewhere."""
    with nullcontext() if doubt is None else pytest.warns(UserWarning, match=f"K: a principal point .*{doubt}"):
        points_of(np.ones(shape), [[40.0, 0, cx], [0, 40, 11.5], [0, 0, 1]])


# -- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (
            lambda: points_of(np.ones((4, 4), np.uint16), K),
            InputError,
            "image: expected floating-point .* found uint16",
        ),
        (lambda: Body.from_depth(np.ones((4, 4), np.uint16), K, radius=0.1), InputError, "divide millimetres by 1000"),
        (lambda: Body.from_depth(np.ones((4, 4, 3)), K, radius=0.1), InputError, "is the image in colour"),
        (
            lambda: points_of(
                np.where(np.eye(9) > 0, 1.0, np.nan) * np.r_[np.ones(8), 1e308], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
            ),
            InputError,
            "points are finite",
        ),
        (lambda: Body.from_depth(np.ones((24, 32)), K), InputError, "radius, voxel: expected one"),
        (lambda: Body.from_depth(np.zeros((24, 32)), K, radius=0.1), GeometryError, "image: expected an echo"),
        (lambda: Body.from_depth(np.ones((24, 32)), np.eye(3)[::-1], radius=0.1), InputError, "K: expected an intrin"),
        (lambda: Body.from_depth(np.ones((24, 32)), K, -np.eye(4), radius=0.1), PoseError, "T_world_camera"),
        (lambda: Body.from_depth(np.ones((24, 32)), K, radius=0.1, q=[0, 0]), InputError, "checker, q: expected both"),
        (
            lambda: Body.from_depth(np.ones((24, 32)), K, radius=0.1, checker=arm(), q=[0, 0]),
            InputError,
            "checker: expected a CollisionChecker, found",
        ),
        (lambda: SeenSpace([0, 0, 0], (1, 1, 1), 0.1).see(np.ones((24, 32)), K, time="now"), InputError, "time"),
        (
            lambda: SeenSpace([0, 0, 0], (1, 1, 1), 0.1).see(np.ones((24, 32)), K, time=np.nan),
            InputError,
            "time: .*nan",
        ),
        (lambda: points_of(np.ones(4), K), InputError, "image: .* found float64 of shape \\(4,\\)"),
        (lambda: points_of(np.ones((24, 32)), np.eye(4)), InputError, "K: expected shape"),
        (lambda: points_of(np.ones((24, 32)), -K), InputError, "K: expected an intrinsic matrix"),
        (lambda: points_of(np.ones((24, 32)), K.T), InputError, "K: expected an intrinsic matrix"),
        (lambda: points_of(np.ones((24, 32)), 0 * K), InputError, "K: expected an intrinsic matrix"),
        (lambda: points_of(np.ones((24, 32)), 2 * K), InputError, "K: expected an intrinsic matrix"),
        (lambda: points_of(np.ones((24, 32)), [40, 40, 15, 11]), InputError, "K: expected shape .3, 3., found"),
        (lambda: points_of(np.ones((24, 32)), np.nan * K), InputError, "K: expected finite numbers"),
        (lambda: points_of(np.ones((24, 32)), K, 2 * np.eye(4)), PoseError, "T_world_camera"),
        (lambda: points_of(np.ones((24, 32)), K, [np.eye(4)] * 2), InputError, "T_world_camera: expected shape"),
        (lambda: SeenSpace([0, 0], (1, 1, 1), 0.1), InputError, "low: expected shape"),
        (lambda: SeenSpace([0, 0, 0], (1, 1), 0.1), InputError, "shape: expected three numbers, found 2"),
        (lambda: SeenSpace([0, 0, 0], (1, 1, 0), 0.1), InputError, "shape: expected .* 1"),
        (lambda: SeenSpace([0, 0, 0], (1, 1, 1), 0.0), InputError, "size: expected"),
        (lambda: SeenSpace([0, 0, 0], (1, 1, 1), 0.1).forget(-1), InputError, "older_than"),
        (lambda: CollisionChecker(arm()).off_the_robot([[0, 0]], [0, 0]), InputError, "points: expected shape"),
        (lambda: CollisionChecker(arm()).off_the_robot([[0, 0, 0]], [0]), InputError, "q: expected"),
        (lambda: CollisionChecker(arm()).off_the_robot([[0, 0, 0]], [0, 0], clear=0), InputError, "clear: expected"),
    ],
)
def test_bad_input(call, error, text):
    """Each error names what was expected and what was found."""
    with pytest.raises(error, match=text):
        call()
