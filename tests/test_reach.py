"""Poses that are reached, by every kind of joint; within limits, tolerances and obstacles; and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from loewner import Body, CollisionChecker, InputError, PoseError, Robot, Scene, UnknownNameError
from loewner.robots.description import reaching
from loewner.robots.description.robot import chain_to
from loewner.robots.description.urdf import read_urdf
from robot_oracle import pinocchio_configuration, robots_folder
from sampling import examples

FREE = np.inf


def joint(name, kind, parent, child, inside='<axis xyz="0 0 1"/><limit lower="-2" upper="2"/>'):
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 -0.6"/>{inside}</joint>'
    )


def robot_of(*joints):
    return Robot.from_urdf(text=f'<robot name="r"><link name="base"/>{"".join(joints)}</robot>')


def arm(before="", base="base"):
    """Six turning joints below whatever is before them, and a hand."""
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    names = (base, "a", "b", "c", "d", "e", "f")
    turns = [
        joint(f"j{k}", "revolute", names[k], names[k + 1], f'<axis xyz="{axis}"/><limit lower="-3" upper="3"/>')
        for k, axis in enumerate(axes)
    ]
    return robot_of(before, *turns, joint("hand", "fixed", "f", "hand"))


def example(name):
    srdf = name.replace("urdf/", "srdf/").replace("_robot", "").replace(".urdf", ".srdf")
    folder = robots_folder()
    return Robot.from_urdf(folder / name, srdf=folder / srdf, package_dirs=[folder.parents[1]])


@pytest.fixture(scope="module")
def panda():
    return example("panda_description/urdf/panda.urdf")


@pytest.fixture(scope="module")
def ur5():
    return example("ur_description/urdf/ur5_robot.urdf")


def poses_of(robot, link, Q):
    return np.ascontiguousarray(robot.forward_kinematics(Q)[..., robot.link_names.index(link), :, :])


def misses(robot, link, found, T):
    """Metres and radians, by NumPy alone."""
    D = np.linalg.inv(T) @ poses_of(robot, link, found.configuration)
    skew = D[..., :3, :3] - D[..., :3, :3].swapaxes(-1, -2)
    sine = np.linalg.norm(np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1), axis=-1) / 2
    cosine = (np.trace(D[..., :3, :3], axis1=-2, axis2=-1) - 1) / 2
    return np.linalg.norm(D[..., :3, 3], axis=-1), np.arctan2(sine, cosine)


def inside(robot, Q):
    return bool(((robot.lower <= Q) & (robot.upper >= Q)).all())


KINDS = {
    "turning": arm(),
    "sliding": arm(joint("slide", "prismatic", "base", "s"), "s"),
    "continuous": arm(joint("round", "continuous", "base", "s", '<axis xyz="1 2 3"/>'), "s"),
    "planar": arm(joint("drive", "planar", "base", "s", '<axis xyz="0 0 1"/>'), "s"),
    "floating": arm(joint("fly", "floating", "base", "s", ""), "s"),
    "mimicking": arm(
        joint("slide", "prismatic", "base", "s")
        + joint(
            "echo",
            "prismatic",
            "s",
            "t",
            '<axis xyz="0 1 1"/><limit lower="-9" upper="9"/><mimic joint="slide" multiplier="-0.5" offset="1"/>',
        ),
        "t",
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_poses_of_the_robot_are_reached(kind):
    """A pose that forward kinematics gives is reached to 1e-9, within the limits, by every kind of joint."""
    robot = KINDS[kind]
    T = poses_of(robot, "hand", robot.random_configurations(100, 1))
    found = robot.reach("hand", T)
    assert found.reached.mean() >= 0.99
    shift, turn = misses(robot, "hand", found, T)
    assert ((shift < 1e-9) & (turn < 1e-9))[found.reached].all()
    assert inside(robot, found.configuration)
    assert (found.residual[found.reached] < 1e-9).all()


def test_real_arms_and_pinocchio(panda, ur5):
    """All of 100 poses by pinocchio's forward kinematics are reached, on a Panda and a UR5."""
    pin = pytest.importorskip("pinocchio")
    for robot, link in ((panda, "panda_hand"), (ur5, "tool0")):
        model, joints = pin.buildModelFromUrdf(str(robot.urdf)), read_urdf(robot.urdf).joints
        data, values = model.createData(), {name: k for k, name in enumerate(robot.configuration_names)}

        def poses(Q, model=model, data=data, joints=joints, values=values, link=link):
            T = []
            for q in Q:
                pin.framesForwardKinematics(model, data, pinocchio_configuration(pin, model, joints, values, q))
                T.append(data.oMf[model.getFrameId(link)].homogeneous)
            return np.array(T)

        T = poses(robot.random_configurations(100, 2))
        found = robot.reach(link, T)
        assert found.reached.all()
        assert inside(robot, found.configuration)
        assert np.abs(poses(found.configuration) - T).max() < 1e-9


def test_all_solutions(ur5):
    """All solutions of a UR5 are found: an even number up to eight, each a solution, no two alike, nearest first."""
    start = np.array([0.3, -1.2, 1.0, -0.7, 1.1, 0.4])
    T = poses_of(ur5, "tool0", np.array([start, [0.5, -1.5, 1.4, -1.0, 1.2, 0.1], [2.0, -0.8, 0.9, 0.3, -0.9, 1.0]]))
    found = ur5.reach("tool0", T, start=start, all=True, seeds=256)
    assert found.free is None
    for target, solutions in zip(T, found.solutions, strict=True):
        assert len(solutions) == 8
        assert max(np.abs(poses_of(ur5, "tool0", solutions) - target).max(axis=(1, 2))) < 1e-9
        assert inside(ur5, solutions)
        assert (np.abs(solutions - start) <= np.pi + 1e-9).all()  # whole turns are removed
        apart = np.linalg.norm(solutions - start, axis=1)
        assert (np.diff(apart) >= 0).all()
        between = np.abs(solutions[:, None] - solutions).max(axis=2) + np.eye(len(solutions))
        assert between.min() > 1e-4
    assert np.abs(found.solutions[0][0] - start).max() < 1e-9
    one = ur5.reach("tool0", T[0], start=start, all=True, seeds=256)
    assert np.array_equal(one.solutions, found.solutions[0])


# The UR5's dimensions [m] and twists, by Denavit and Hartenberg.
HEIGHTS, LENGTHS = (0.089159, 0, 0, 0.10915, 0.09465, 0.0823), (0, -0.425, -0.39225, 0, 0, 0)
TWISTS = np.array([1, 0, 0, 1, -1, 0]) * np.pi / 2


def ur5_joint(k, angle):
    """Pose of a UR5's link in the frame of the link before it."""
    c, s, across, along = np.cos(angle), np.sin(angle), np.cos(TWISTS[k]), np.sin(TWISTS[k])
    return np.array(
        [
            [c, -s * across, s * along, LENGTHS[k] * c],
            [s, c * across, -c * along, LENGTHS[k] * s],
            [0, along, across, HEIGHTS[k]],
            [0, 0, 0, 1],
        ]
    )


def ur5_closed_form(T):
    """All configurations, up to whole turns, at which a UR5's tool has a pose.

    The wrist's center gives two angles of the shoulder, and its height above the arm's plane two of the fifth joint.
    These leave three parallel joints, two of which span a triangle with the arm's length.
    """
    T = np.diag([-1.0, -1, 1, 1]) @ T  # the model's base is turned by half a turn
    found = []
    x, y = T[:2, 3] - HEIGHTS[5] * T[:2, 2]
    for shoulder in (1, -1):
        q1 = np.arctan2(y, x) + np.pi / 2 + shoulder * np.arccos(HEIGHTS[3] / np.hypot(x, y))
        T1 = np.linalg.inv(ur5_joint(0, q1)) @ T
        for wrist in (1, -1):
            q5 = wrist * np.arccos((T1[2, 3] - HEIGHTS[3]) / HEIGHTS[5])
            q6 = np.arctan2(-wrist * T1[2, 1], wrist * T1[2, 0])
            T4 = T1 @ np.linalg.inv(ur5_joint(4, q5) @ ur5_joint(5, q6))
            a, b, (px, py) = LENGTHS[1], LENGTHS[2], T4[:2, 3]
            cosine = (px * px + py * py - a * a - b * b) / (2 * a * b)
            for elbow in (1, -1) if abs(cosine) < 1 else ():
                q3 = elbow * np.arccos(cosine)
                q2 = np.arctan2(py, px) - np.arctan2(b * np.sin(q3), a + b * np.cos(q3))
                found.append([q1, q2, q3, np.arctan2(T4[1, 0], T4[0, 0]) - q2 - q3, q5, q6])
    return np.array(found)


def test_all_solutions_are_those_of_the_closed_form(ur5):
    """For 300 poses, a UR5's solutions are those of its closed form, up to eight, each found and no others."""
    T = poses_of(ur5, "tool0", ur5.random_configurations(300, 5))
    counts = []
    for target, solutions in zip(T, ur5.reach("tool0", T, all=True, seeds=256).solutions, strict=True):
        expected = ur5_closed_form(target)
        assert np.abs(poses_of(ur5, "tool0", expected) - target).max() < 1e-9
        apart = np.abs(np.remainder(expected[:, None] - solutions + np.pi, 2 * np.pi) - np.pi).max(axis=2)
        assert apart.min(axis=1).max() < 1e-6
        assert apart.min(axis=0).max() < 1e-6
        counts.append(len(expected))
    assert set(counts) >= {4, 8}


@pytest.mark.parametrize("far", [1e200, np.nan, np.inf])
def test_the_kernel_gives_up_what_is_not_finite(ur5, far):
    """Seeds whose error overflows or is not a number end the search, which reports no solution and no nearness."""
    chain = chain_to(ur5, "tool0")
    T, starts = np.eye(4)[None].copy(), np.full((1, 6), 0.3)
    T[0, 0, 3] = far
    found = reaching.solve(chain, T, starts, reaching.seeded(chain, 20), 22, np.zeros(6))
    assert found.counts.tolist() == [0]
    assert np.array_equal(found.nearest[0, :6], starts[0])
    assert np.isinf(found.nearest[0, 6:]).all()


def test_tolerances(panda):
    """Free directions stay free, ranges are kept, and the rest is exact."""
    T = poses_of(panda, "panda_hand", panda.random_configurations(50, 3))
    found = panda.reach("panda_hand", T, tolerance=[0, 0, 0, FREE, FREE, FREE])
    assert found.reached.all()
    assert misses(panda, "panda_hand", found, T)[0].max() < 1e-9
    T[:, :3, :3] = T[:, :3, [1, 2, 0]]
    found = panda.reach("panda_hand", T, tolerance=[0, 0, 0, 0, 0, FREE])
    D = np.linalg.inv(T) @ poses_of(panda, "panda_hand", found.configuration)
    assert found.reached.mean() > 0.8
    D = D[found.reached]
    assert np.abs(D[:, :3, 3]).max() < 1e-9
    assert np.abs(D[:, :2, 2]).max() < 1e-9
    assert D[:, 2, 2].min() > 0
    assert np.abs(D[:, 0, 1]).max() > 0.1  # it did spin
    ranges = np.array([0.01, 0.02, 0.0, 0.1, 0.0, 0.5])
    found = panda.reach("panda_hand", T, tolerance=ranges)
    assert found.reached.mean() > 0.8
    D = (np.linalg.inv(T) @ poses_of(panda, "panda_hand", found.configuration))[found.reached]
    tilt = np.arccos(np.clip(D[:, 2, 2], -1, 1))
    spin = np.arctan2(D[:, 1, 0] - D[:, 0, 1], D[:, 0, 0] + D[:, 1, 1])
    assert (np.abs(D[:, :3, 3]) <= ranges[:3] + 1e-9).all()
    assert (tilt <= 0.1 + 1e-9).all()  # no tilt about y
    assert np.abs(D[:, 0, 2]).max() < 1e-9
    assert (np.abs(spin) <= 0.5 + 1e-9).all()
    assert np.abs(spin).max() > 0.49


def test_other_joints_stay(panda):
    """Joints that do not move the link, and joints that may not move, keep the start's values."""
    start = panda.random_configurations(1, 4)[0]
    T = poses_of(panda, "panda_link4", panda.random_configurations(20, 5))
    found = panda.reach("panda_link4", T, start=start, tolerance=[0, 0, 0, FREE, FREE, FREE])
    assert np.array_equal(found.configuration[:, 4:], np.tile(start[4:], (20, 1)))
    some = ["panda_joint1", "panda_joint2", "panda_joint4"]
    found = panda.reach("panda_hand", T, joints=some, start=start, tolerance=[0, 0, 0, FREE, FREE, FREE])
    still = [k for k, name in enumerate(panda.configuration_names) if name not in some]
    assert np.array_equal(found.configuration[:, still], np.tile(start[still], (20, 1)))
    assert found.reached.any()


def test_what_is_not_reached_is_as_near_as_can_be():
    """On a rail of 2 m, a pose 1.5 m beyond its end is missed by 1.5 m, and one turned by 1 rad by that angle."""
    robot = robot_of(
        '<link name="tool"/><joint name="rail" type="prismatic"><parent link="base"/><child link="tool"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="2"/></joint>'
    )
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 0, 3] = 3.5, 1.0, 0.5
    T[1, :3, :3] = [[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]]
    found = robot.reach("tool", T)
    assert found.reached.tolist() == [False, False, True]
    assert np.allclose(found.residual, [[1.5, 0], [0, 1], [0, 0]], atol=1e-6)
    assert np.allclose(found.configuration[:, 0], [2, 1, 0.5], atol=1e-6)
    assert robot.reach("tool", T[:2], all=True).solutions[0].shape == (0, 1)
    turns = Rotation.random(50, random_state=0)
    T = np.tile(np.eye(4), (50, 1, 1))
    T[:, :3, :3] = turns.as_matrix()
    assert np.allclose(robot.reach("tool", T).residual[:, 1], turns.magnitude(), atol=1e-7)


def test_free_solutions_come_first(panda):
    """With a checker, a solution is free if any of all is; free ones come first."""
    scene = Scene()
    rng = np.random.default_rng(6)
    for k in range(8):
        at = np.eye(4)
        at[:3, 3] = rng.uniform([-0.7, -0.7, 0.2], [0.7, 0.7, 0.9])
        scene.add(f"ball {k}", Body.sphere(0.12), at)
    checker = CollisionChecker(panda, scene)
    Q = panda.random_configurations(300, 7)
    T = poses_of(panda, "panda_hand", Q[~checker.collide(Q)][:40])
    found = panda.reach("panda_hand", T, checker=checker)
    assert found.reached.mean() > 0.9
    assert not checker.collide(found.configuration[found.reached]).any()
    every = panda.reach("panda_hand", T, checker=checker, all=True)
    assert (every.reached >= found.reached).all()
    for count, solutions in zip(every.free, every.solutions, strict=True):
        collides = checker.collide(solutions)
        assert not collides[:count].any()
        assert collides[count:].all()
    scene.add("everything", Body.sphere(9.0))
    blocked = panda.reach("panda_hand", T[0], checker=checker)
    assert not blocked.reached
    assert blocked.residual.max() < 1e-9


def test_answers_depend_neither_on_threads_nor_on_what_follows(panda):
    """A batch gives the same answers in parts that begin where a chain of starts begins; a start is its own answer."""
    Q = panda.random_configurations(3 * reaching.CHAINED, 8)
    T = poses_of(panda, "panda_hand", Q)
    found = panda.reach("panda_hand", T)
    for first in range(0, len(T), reaching.CHAINED):
        part = panda.reach("panda_hand", T[first : first + reaching.CHAINED])
        assert np.array_equal(part.configuration, found.configuration[first : first + reaching.CHAINED])
    same = panda.reach("panda_hand", T, start=Q)
    assert np.abs(same.configuration - Q).max() < 1e-9
    assert panda.reach("panda_hand", T.reshape(3, -1, 4, 4)).residual.shape == (3, reaching.CHAINED, 2)
    assert panda.reach("panda_hand", T[:0]).configuration.shape == (0, panda.dof)


def test_an_almost_rigid_pose_is_reached(panda):
    """Rotations that are off by rounding to single precision are made orthonormal first."""
    T = poses_of(panda, "panda_hand", panda.random_configurations(20, 9)).astype(np.float32).astype(np.float64)
    assert panda.reach("panda_hand", T).reached.all()


def test_bad_input(panda):
    """Each bad argument is refused with its name."""
    T, checker = np.eye(4), CollisionChecker(panda)
    with pytest.raises(UnknownNameError, match="link"):
        panda.reach("hand", T)
    with pytest.raises(InputError, match="expected one that the joints move .*found 'panda_link0'"):
        panda.reach("panda_link0", T)
    with pytest.raises(InputError, match="expected one that the joints move .*found 'panda_link3'"):
        panda.reach("panda_link3", T, joints=["panda_joint7"])
    with pytest.raises(PoseError, match="T: expected a rotation"):
        panda.reach("panda_hand", np.diag([2.0, 2, 2, 1]))
    with pytest.raises(PoseError, match="T: expected shape"):
        panda.reach("panda_hand", T[:3])
    for tolerance in ([0, 0, 0], [-1, 0, 0, 0, 0, 0], [np.nan, 0, 0, 0, 0, 0], "much"):
        with pytest.raises(InputError, match="tolerance: expected"):
            panda.reach("panda_hand", T, tolerance=tolerance)
    with pytest.raises(InputError, match="seeds"):
        panda.reach("panda_hand", T, seeds=0)
    with pytest.raises(InputError, match="checker: expected a loewner.CollisionChecker of this robot"):
        panda.reach("panda_hand", T, checker=object())
    with pytest.raises(InputError, match="start: expected shape"):
        panda.reach("panda_hand", T, start=[0, 0])
    with pytest.raises(InputError, match="expected T and start whose shapes|broadcast"):
        panda.reach("panda_hand", np.tile(T, (3, 1, 1)), start=np.zeros((2, panda.dof)))
    with pytest.raises(UnknownNameError, match="joints"):
        panda.reach("panda_hand", T, joints=["elbow"])
    assert panda.reach("panda_hand", T, checker=checker) is not None


def test_far_numbers(panda):
    """Lengths whose squares overflow are refused, wherever they come from: the search would not end."""
    T, far = np.eye(4), np.eye(4)
    far[0, 3] = 1e200
    with pytest.raises(InputError, match="T: expected lengths and values within"):
        panda.reach("panda_hand", [T, far])
    with pytest.raises(InputError, match="robot: expected lengths"):
        panda.placed(far).reach("panda_hand", T)
    based = panda.add_base("planar")
    start = based.configuration()
    start[0] = 1e200
    with pytest.raises(InputError, match="start: expected lengths"):
        based.reach("panda_hand", T, start=start)
    far[0, 3] = 1e49
    assert not panda.reach("panda_hand", far).reached


def test_no_poses(panda):
    """No poses have no solutions."""
    found = panda.reach("panda_hand", np.empty((0, 4, 4)), all=True, checker=CollisionChecker(panda))
    assert found.solutions == ()
    assert found.free.shape == found.reached.shape == (0,)


def turning(lower, upper, kind="revolute"):
    return robot_of(joint("j", kind, "base", "tool", f'<axis xyz="0 0 1"/><limit lower="{lower}" upper="{upper}"/>'))


AMOUNTS = st.sampled_from([1e-15, 1e-9, 1e-4, 0.2, 3.0, 7.0, 1e3, 1e9])


@given(data=st.data())
@examples(24, 60)
@pytest.mark.filterwarnings("ignore:.*in degrees:UserWarning")  # starts far outside the limits
def test_what_is_reached_is_within_the_limits(data):
    """From any start, also one outside, every solution is within the limits of the joints that move, and reaches."""
    robot = KINDS[data.draw(st.sampled_from([*KINDS]))]
    kept = data.draw(st.sampled_from([None, "j0", "j3"]))
    joints = None if kept is None else [name for name in robot.joint_names if name != kept]
    start = robot.random_configurations(1, data.draw(st.integers(0, 99)))[0]
    names, single = robot.configuration_names, np.isin(robot.configuration_names, robot.joint_names)
    bounded = np.flatnonzero(single & np.isfinite(robot.lower) & np.isfinite(robot.upper))
    for k in data.draw(st.lists(st.sampled_from(bounded.tolist()), min_size=1, max_size=3)):
        up, amount = data.draw(st.booleans()), data.draw(AMOUNTS)
        start[k] = (
            np.nextafter(robot.upper[k] + amount, np.inf) if up else np.nextafter(robot.lower[k] - amount, -np.inf)
        )
    others = robot.random_configurations(2, 5)
    T = poses_of(robot, "hand", np.stack([start, *others]))
    every = data.draw(st.booleans())
    found = robot.reach("hand", T, start=start, joints=joints, all=every)
    moves = np.array([name != kept for name in names])
    solutions = np.concatenate([found.configuration[found.reached], *(found.solutions or ())])
    if kept is not None:
        held = names.index(kept)
        assert (solutions[:, held] == start[held]).all()
    assert ((robot.lower <= solutions) & (solutions <= robot.upper))[:, moves].all()
    shift, turn = misses(robot, "hand", found, T)
    assert ((shift < 1e-8) & (turn < 1e-8))[found.reached].all()
    assert ((robot.lower <= found.configuration) & (found.configuration <= robot.upper))[:, moves].all()


@pytest.mark.parametrize("every", [False, True])
def test_a_pose_outside_the_limits_is_not_reached_from_itself(every):
    """A joint of 0 to 1 rad does not reach the pose of 1.2 rad, nor does an encoder slightly beyond its stop."""
    robot = turning(0, 1)
    for value in (1.2, 1.0001, np.nextafter(1.0, 2.0) + 1e-9, -0.3):
        found = robot.reach("tool", poses_of(robot, "tool", [value]), start=[value], all=every)
        assert not found.reached
        assert found.configuration == (1.0 if value > 0 else 0.0)
        assert np.allclose(found.residual, [0, abs(value - found.configuration[0])], atol=1e-9)
        assert not every or len(found.solutions) == 0
    inner = robot.reach("tool", poses_of(robot, "tool", [0.4]), start=[1.2], all=every)
    assert inner.reached
    assert inner.configuration == pytest.approx([0.4], abs=1e-9)
    other = robot_of(joint("j", "revolute", "base", "tool"), joint("k", "revolute", "tool", "end"))
    held = other.reach("end", poses_of(other, "end", [2.5, 0.3]), start=[2.5, 1.0], joints="k", all=every)
    assert held.reached  # a joint that does not move keeps its value, and limits are not its own
    assert held.configuration == pytest.approx([2.5, 0.3], abs=1e-9)


@given(
    middle=st.floats(-100, 100),
    width=st.floats(2 * np.pi, 50),
    angle=st.floats(-np.pi, np.pi),
    start=st.one_of(st.floats(-60, 60), st.floats(-1e5, 1e5)),
)
@settings(max_examples=60, deadline=None)
@pytest.mark.filterwarnings("ignore:.*in degrees:UserWarning")
def test_ranges_of_many_turns(middle, width, angle, start):
    """A joint of a turn or more reaches every angle within its limits, as near to the start as they allow."""
    robot = turning(middle - width / 2, middle + width / 2)
    lower, upper = robot.lower[0], robot.upper[0]
    T = poses_of(robot, "tool", [angle])
    turns = angle + 2 * np.pi * np.arange(np.ceil((lower - angle) / (2 * np.pi)), (upper - angle) / (2 * np.pi))
    for every in (False, True):
        found = robot.reach("tool", T, start=[start], all=every)
        assert found.reached
        (value,) = found.configuration
        assert lower <= value <= upper
        assert np.abs(np.remainder(value - angle + np.pi, 2 * np.pi) - np.pi) < 1e-8
        if upper - lower > 2 * np.pi + 1e-6 and len(turns):
            assert abs(value - start) <= np.abs(turns - start).min() + 1e-8
        assert not every or ((lower <= found.solutions) & (found.solutions <= upper)).all()
