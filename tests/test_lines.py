"""Lines of a link: near enough at every instant, in bounds that mutants break; errors that say where a line ends."""

from itertools import pairwise

import numpy as np
import pytest

from families import translation
from gantry import LEFT, gantry_robot, wall
from interpreted_kernels import interpreted, source_of
from loewner import CollisionChecker, InputError, PlanningError, PoseError, Robot, UnknownNameError, planners
from loewner._kernels import codes
from loewner._native import entries
from loewner.robots.description.robot import chain_to, sources_of
from sampling import quick
from test_reach import arm, joint, robot_of

KERNEL = interpreted("robots.lines")

DENSE = np.linspace(0.0, 1.0, 401)

# Single joints and pairs whose second derivatives attain the bound, then arms of every kind of joint.
ROD = (
    '<link name="tool"/><joint name="f" type="fixed"><parent link="{0}"/><child link="tool"/>'
    '<origin xyz="0.7 0 0"/></joint>'
)


BALL = '<link name="base"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'


def with_bodies(robot):
    """A checker of the robot, at whose base and tip there are small balls that never meet."""
    text = sources_of(robot)[0].text.replace('<link name="base"/>', BALL)
    last = robot.link_names[-1]
    text = text.replace(f'<link name="{last}"/>', BALL.replace("base", last))
    return CollisionChecker(Robot.from_urdf(text=text))


def bare(name, kind, parent, child, axis, inside='<limit lower="-3" upper="3"/>'):
    """A joint at the origin of its parent."""
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/>{inside}</joint>'
    )


TIGHT = {
    "turn": robot_of(bare("a", "revolute", "base", "l", "0 0 1"), ROD.format("l")),
    "two turns": robot_of(
        bare("a", "revolute", "base", "l", "0 0 1"), bare("b", "revolute", "l", "m", "0 0 1"), ROD.format("m")
    ),
    "turn and slide": robot_of(
        bare("a", "revolute", "base", "l", "0 0 1"), bare("b", "prismatic", "l", "m", "1 0 0"), ROD.format("m")
    ),
    "echo": robot_of(
        bare("a", "revolute", "base", "l", "0 0 1"),
        bare("b", "revolute", "l", "m", "0 0 1", '<limit lower="-9" upper="9"/><mimic joint="a" multiplier="2"/>'),
        ROD.format("m"),
    ),
}
ARMS = {
    "turning": (arm(), "hand"),
    "sliding": (arm(joint("slide", "prismatic", "base", "s"), "s"), "hand"),
    "planar": (arm(joint("drive", "planar", "base", "s", '<axis xyz="0 0 1"/>'), "s"), "hand"),
}


def line_of(kernel, T0, T1):
    """The kernel's line between two poses."""
    flat = [(tuple(T[:3, :3].ravel().tolist()), tuple(T[:3, 3].tolist())) for T in (T0, T1)]
    return kernel.line_between(*flat[0], *flat[1])


def poses_of(line, u):
    """Poses of a line at fractions."""
    angles, T = (line.angle * u)[:, None, None], np.zeros((len(u), 4, 4))
    rotation, sine, cosine = (np.reshape(part, (3, 3)) for part in (line.rotation, line.sine, line.cosine))
    T[:, :3, :3] = rotation + np.sin(angles) * sine + (1 - np.cos(angles)) * cosine
    T[:, :3, 3], T[:, 3, 3] = line.start + u[:, None] * np.array(line.way), 1.0
    return T


def bounds(kernel, chain, line, kept, u, Q):
    """Bounds of one motion by the kernel."""
    wanted = kernel.Wanted(1e-4, 1e-3, -np.inf, *(tuple(vector.tolist()) for vector in kept))
    Q = np.array(Q)[:, chain.columns]
    still, tables = np.zeros(Q.shape[1]), (chain.links, chain.constants)
    ends = [kernel.gaps_of(*tables, line, wanted, at, q, still) for at, q in zip(u, Q, strict=True)]
    return kernel.strays_of(*tables, line, wanted, *ends, *u, (Q[0] + Q[1]) / 2, Q[1] - Q[0])


def samples(robot, link, q0, q1, kept):
    """The line of a motion's ends; the largest deviations from it, of samples; and what the largest second difference
    would allow, which the bounds must cover, too."""
    number = robot.link_names.index(link)
    poses = robot.forward_kinematics(q0 + DENSE[:, None] * (np.array(q1) - q0))[:, number]
    line = line_of(KERNEL, poses[0], poses[-1])
    off = poses[:, :3] - poses_of(line, DENSE)[:, :3]
    cosines = poses[:, :3, :3] @ kept[0] @ kept[1]
    bends = np.diff(off, 2, axis=0) * (len(DENSE) - 1) ** 2
    positions = np.linalg.norm(off[..., 3], axis=1).max(), np.linalg.norm(bends[..., 3], axis=1).max() / 8
    rotations = [np.linalg.norm(x[..., :3], axis=(1, 2)).max() for x in (off, bends / 8)]
    falls = np.abs(np.diff(cosines, 2)).max() * (len(DENSE) - 1) ** 2 / 8
    return line, positions, rotations, (cosines.min(), min(cosines[0], cosines[-1]) - falls)


def cases(seed=0, count=30):
    rng = np.random.default_rng(seed)
    for robot in TIGHT.values():
        for size in (0.01, 0.1, 0.4):
            q = rng.uniform(0.5, 1.0, robot.dof)
            yield robot, "tool", q, q + size
    for robot, link in ARMS.values():
        for _ in range(count):
            q = rng.uniform(-1.5, 1.5, robot.dof)
            yield robot, link, q, q + rng.choice([0.03, 0.2, 0.8]) * rng.uniform(-1, 1, robot.dof)


@pytest.fixture(scope="module")
def sampled():
    """The motions above beside samples of them."""
    rng, made = np.random.default_rng(1), []
    for robot, link, q0, q1 in cases():
        kept = rng.normal(size=(2, 3))
        kept /= np.linalg.norm(kept, axis=1, keepdims=True)
        made.append((chain_to(robot, link), kept, (q0, q1), samples(robot, link, q0, q1, kept)))
    return made


def broken(kernel, sampled, most=None):
    """How many motions stray farther than the kernel's bounds, and the least of bound over sample.

    The search ends with a number of motions that do, if one is given.
    """
    count, tightest = 0, np.inf
    for chain, kept, ends, (line, positions, rotations, least) in sampled:
        found = bounds(kernel, chain, line, kept, (0.0, 1.0), ends)
        spare = 1 + 1e-4, 1e-8  # of differences
        count += (
            found.position < positions[0]
            or found.rotation < rotations[0]
            or found.cosine > least[0]
            or found.position * spare[0] + spare[1] < positions[1]
            or found.rotation * spare[0] + spare[1] < rotations[1]
            or found.cosine - spare[1] > least[1]
        )
        if count == most:
            break
        if positions[0] > 1e-6:
            tightest = min(tightest, found.position / positions[0])
    return count, tightest


def test_bounds_hold(sampled):
    """No sample strays farther than the bound, by position, rotation or kept axis; the bound is attained within 1 %."""
    count, tightest = broken(KERNEL, sampled)
    assert count == 0
    assert tightest < 1.01


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("MIDDLE = 0.125", "MIDDLE = 0.12"),
        ("plus(m.bend, cross(m.turn, b))", "m.bend"),
        ("plus(m.pull, cross(m.bend, r))", "m.pull"),
        ("cross(m.turn, cross(m.turn, r))", "scaled(0.0, r)"),
        ("scaled(2.0 * rate, cross", "scaled(rate, cross"),
        ("bend + twist + rounding", "bend + rounding"),
        ("turn_bend + turn_twist + rounding", "turn_bend + rounding"),
        ("least - tilt - tilt_twist", "least - tilt"),
        ("least - tilt - tilt_twist", "least - tilt_twist"),
        ("AXIS)), load(d, at) * multiplier)", "AXIS)), load(d, at))"),
        ("b[0] * b[1] - a[2]", "b[0] * b[1] + a[2]"),
        ("b[2] * b[2] - square", "b[2] * b[2]"),
        ("third = m.third + size", "third = m.third + 0.0 * size"),
    ],
)
def test_mutants_of_the_bounds_are_found(old, new, sampled):
    """If a factor or a term of the bound is dropped, some motion strays farther."""
    text = source_of("robots.lines")
    assert text.count(old) == 1
    assert broken(interpreted("robots.lines", text.replace(old, new)), sampled, most=1)[0] > 0


@pytest.mark.parametrize("kind", ARMS)
def test_the_compiled_kernel_bounds_likewise(kind):
    """Every motion that the compiled kernel returns is within the tolerances by the interpreted one."""
    robot, link = ARMS[kind]
    chain, rng, total = chain_to(robot, link), np.random.default_rng(4), 0
    for _ in range(5):
        q = rng.uniform(-1.5, 1.5, robot.dof)
        T0, T1 = robot.forward_kinematics(np.stack([q, q + 0.2]))[:, robot.link_names.index(link)]
        wanted = np.array([1e-3, 2e-3, 0.9, 0, 0, 1, *T0[:3, 2]])
        outcome, rows = entries.follow_line(*chain[:3], q[chain.columns], T1, wanted)
        line, kept = line_of(KERNEL, T0, T1), wanted[3:].reshape(2, 3)
        count = len(rows) if outcome == codes.FOLLOWED else len(rows) - 1
        for before, after in pairwise(rows[:count]):
            found = bounds(KERNEL, chain, line, kept, (before[0], after[0]), (before[2:], after[2:]))
            assert found.position <= 1e-3 * (1 + 1e-9)
            assert found.rotation <= 2e-3 * (1 + 1e-9)
            assert found.cosine >= 0.9 - 1e-9
        total += count
    assert total > 50


def strayed(robot, link, path, T, samples=50):
    """Largest metres and radians between the motions and the line, of samples, by the fraction of the line."""
    number = robot.link_names.index(link)
    line = line_of(KERNEL, robot.forward_kinematics(path[0])[number], np.asarray(T))
    # The fractions of rows: they are on the line, so the nearest pose of the line is theirs.
    fine = np.linspace(0, 1, 20001)
    targets = poses_of(line, fine)
    rows = robot.forward_kinematics(path)[:, number]
    gaps = np.linalg.norm(rows[:, None, :3] - targets[None, :, :3], axis=(2, 3))
    u = fine[gaps.argmin(axis=1)]
    s = np.linspace(0, 1, samples)
    Q = path[:-1, None] + s[:, None] * (path[1:] - path[:-1])[:, None]
    at = (u[:-1, None] + s * (u[1:] - u[:-1])[:, None]).ravel()
    D = robot.forward_kinematics(Q.reshape(-1, robot.dof))[:, number]
    wanted = poses_of(line, at)
    E = wanted[:, :3, :3].swapaxes(1, 2) @ D[:, :3, :3]
    chord = np.linalg.norm(E - np.eye(3), axis=(1, 2)) / np.sqrt(8)
    return np.linalg.norm(D[:, :3, 3] - wanted[:, :3, 3], axis=1).max(), 2 * np.arcsin(chord).max()


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("count", quick(5, 12))
def test_lines_are_followed(kind, count):
    """A line ends at its target, and no sample of its motions strays farther than the tolerances."""
    robot, link = ARMS[kind]
    checker, solved = with_bodies(robot), 0
    rng = np.random.default_rng(2)
    for _ in range(count):
        q = rng.uniform(-1.5, 1.5, robot.dof)
        T = robot.forward_kinematics(q + rng.uniform(-0.3, 0.3, robot.dof))[robot.link_names.index(link)]
        try:
            path = planners.straight(checker, q, link, T, position=1e-3, rotation=1e-2)
        except PlanningError:
            continue
        solved += 1
        assert np.array_equal(path[0], q)
        assert np.abs(robot.forward_kinematics(path[-1])[robot.link_names.index(link)] - T).max() < 1e-9
        assert ((path >= robot.lower) & (path <= robot.upper)).all()
        shift, turn = strayed(robot, link, path, T)
        assert shift <= 1e-3 + 1e-4  # fractions of the rows are known to 1/20000 of the line
        assert turn <= 1e-2 + 1e-4
    assert solved >= count - 4


def test_one_joint():
    """A rail follows its line in one motion; a turning rod cannot follow a chord at all."""
    rail = robot_of(bare("rail", "prismatic", "base", "tool", "1 0 0"))
    checker = with_bodies(rail)
    assert np.allclose(planners.straight(checker, [0.0], "tool", translation(x=2.0)), [[0], [2]])
    assert np.array_equal(planners.straight(checker, [0.5], "tool", translation(x=0.5)), [[0.5], [0.5]])
    with pytest.raises(PlanningError, match=r"beyond the fraction 0.75.*limits: rail = 3"):
        planners.straight(checker, [0.0], "tool", translation(x=4.0))
    rod = TIGHT["turn"]
    T = rod.forward_kinematics([1.0])[rod.link_names.index("tool")]
    with pytest.raises(PlanningError, match=r"beyond the fraction 0:.*fewer than six joints"):
        planners.straight(with_bodies(rod), [0.0], "tool", T)


def test_what_is_in_the_way(tmp_path):
    """A collision is an error that states the fraction of the line and the bodies."""
    checker = CollisionChecker(gantry_robot(tmp_path), wall())
    ball = checker.robot.forward_kinematics(LEFT)[checker.robot.link_names.index("ball")]
    ball[0, 3] += 1.0
    with pytest.raises(PlanningError, match=r"line: expected a free line of ball, .* wall .* at the fraction 0\.[3-6]"):
        planners.straight(checker, LEFT, "ball", ball)
    ball[0, 3] -= 1.2
    path = planners.straight(checker, LEFT, "ball", ball)
    assert np.allclose(path[-1], [LEFT[0] - 0.2, *LEFT[1:]])


def test_a_kept_axis():
    """A cup stays upright along a line that keeps it upright, and one that tilts it is refused."""
    robot, link = ARMS["turning"]
    checker, number = with_bodies(robot), robot.link_names.index(link)
    q = np.array([0.3, 0.6, 0.7, 0.2, 0.4, 0.1])
    T = robot.forward_kinematics(q)[number]
    up = T[:3, 2].copy()
    T[:3, 3] += 0.05, -0.03, 0.02
    path = planners.straight(checker, q, link, T, keep=("z", up, 0.01))
    Q = robot.between(path[:-1, None], path[1:, None], np.linspace(0, 1, 50))
    assert np.arccos(np.minimum(robot.forward_kinematics(Q)[..., number, :3, 2] @ up, 1.0)).max() <= 0.01
    turned = robot.forward_kinematics(q + 0.1)[number]
    with pytest.raises(PlanningError, match=r"line: expected .* to keep within 0.01 rad .* at the fraction 0\.\d+"):
        planners.straight(checker, q, link, turned, keep=("z", up, 0.01))


def test_bad_input():
    """Each bad argument is refused with its name."""
    robot, link = ARMS["turning"]
    checker, q = with_bodies(robot), np.full(6, 0.5)
    T = robot.forward_kinematics(q)[robot.link_names.index(link)]
    with pytest.raises(UnknownNameError, match="link"):
        planners.straight(checker, q, "hands", T)
    with pytest.raises(PoseError, match="T: expected"):
        planners.straight(checker, q, link, np.zeros((4, 4)))
    for name in ("position", "rotation"):
        with pytest.raises(InputError, match=f"{name}: expected"):
            planners.straight(checker, q, link, T, **{name: 0.0})
        with pytest.raises(InputError, match=f"{name}: expected at least 1e-09"):
            planners.straight(checker, q, link, T, **{name: 5e-324})
    for far in (1e5, 1e200):
        with pytest.raises(InputError, match="T: expected"):
            planners.straight(checker, q, link, translation(x=far))
    for keep in (
        ("z", [0, 0, 1]),
        ("w", [0, 0, 1], 0.1),
        ("z", [0, 0, 0], 0.1),
        ("z", [0, 0, 1], -1.0),
        ("z", [0, 0, 1], 1e-9),
        3,
    ):
        with pytest.raises((InputError, UnknownNameError), match="keep"):
            planners.straight(checker, q, link, T, keep=keep)
    half = T.copy()
    half[:3, :2] *= -1
    with pytest.raises(InputError, match="half a turn"):
        planners.straight(checker, q, link, half)
    with pytest.raises(PlanningError, match="start: expected a configuration within the limits.*j0 = 4"):
        planners.straight(checker, [4.0, *q[1:]], link, T)
    flying = arm(joint("fly", "floating", "base", "s", ""), "s")
    start = flying.configuration()
    with pytest.raises(InputError, match="floating or ball joint"):
        planners.straight(with_bodies(flying), start, "hand", T)
    turning = [f"j{k}" for k in range(6)]
    here = flying.forward_kinematics(start)[flying.link_names.index("hand")]
    assert len(planners.straight(with_bodies(flying), start, "hand", here, joints=turning)) == 2
