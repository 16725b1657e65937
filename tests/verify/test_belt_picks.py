"""A thousand picks from belts: contact only where it is allowed, and no joint beyond its limits."""

import numpy as np
import pytest
from scipy.interpolate import BPoly, PPoly

from families import translation
from loewner import Body, CollisionChecker, Robot, Scene, Verdict, planners

pytestmark = pytest.mark.verify

PICKS, SAMPLES = 1000, 501
FAST, STRONG = np.array([2.0, 2.0, 2.0, 0.5]), np.array([6.0, 6.0, 6.0, 3.0])

# From the gripper's origin to the middle of its fingers, and its height over the parts [m].
REACH, HIGH = 0.125, 0.15

# Rounding of gaps, and a depth that is refused; the proof's tolerance is a hundredth of a millimetre [m].
ROUNDED, TOO_DEEP = 1e-12, 3e-5

# A palm that slides along x, y and z, with two fingers that open along x; the second mimics the first.
URDF = """<robot name="picker"><link name="base"/><link name="a"/><link name="b"/>
<link name="palm"><collision><geometry><box size="0.2 0.04 0.04"/></geometry></collision></link>
<link name="left"><collision><origin xyz="0.01 0 -0.08"/><geometry><box size="0.02 0.03 0.1"/></geometry></collision>
</link>
<link name="right"><collision><origin xyz="-0.01 0 -0.08"/><geometry><box size="0.02 0.03 0.1"/></geometry></collision>
</link>
<joint name="x" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1"/></joint>
<joint name="y" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="3"/></joint>
<joint name="z" type="prismatic"><parent link="b"/><child link="palm"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="1"/></joint>
<joint name="open" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.07"/></joint>
<joint name="opened" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="-1 0 0"/>
  <limit lower="0" upper="0.07"/><mimic joint="open"/></joint></robot>"""


@pytest.fixture(scope="module")
def picker():
    """A gantry with a gripper; its palm and fingers touch each other."""
    return Robot.from_urdf(text=URDF, srdf=None)


def largest(curve):
    """The largest velocities and accelerations at ends of pieces, or where the next derivative is 0."""
    found = np.zeros((2, curve.c.shape[2]))
    for order, most in enumerate(found, start=1):
        rates = curve.derivative(order).c
        for k, j in np.ndindex(rates.shape[1:]):
            rate, T = np.poly1d(rates[:, k, j]), curve.x[k + 1] - curve.x[k]
            turns = rate.deriv().roots.real
            turns = turns[(turns > 0) & (turns < T)]
            most[j] = np.abs(rate(np.concatenate([[0.0, T], turns]))).max(initial=most[j])
    return found


def keeps_limits(curve):
    """Velocities and accelerations of the polynomials are within the limits at every real time."""
    speeds, pushes = largest(curve)
    assert (speeds <= FAST).all()
    assert (pushes <= STRONG).all()


def curve_of(times, rows):
    """A curve of degree five with given positions, velocities and accelerations at given times."""
    return PPoly.from_bernstein_basis(BPoly.from_derivatives(times, rows))


def gaps(curve, t, part, size):
    """Gaps of both fingers to the part along x, and of the part's bottom to the belt; all from joint values alone."""
    x, _, z, opening = curve(t).T
    return x + opening - part - size[0] / 2, part - size[0] / 2 - x + opening, z - REACH - size[2] / 2


@pytest.mark.parametrize("tenth", range(10))
def test_picks_from_a_belt(picker, tenth):
    """The robot meets the part at the belt's velocity, goes down with it, closes on it, and lifts it at this velocity.

    The part is on the belt, and the fingers touch it at the end of the way down: these contacts are the only ones.
    In every tenth pick, curves that close, or push the part into the belt, by 0.03 mm more are tried, and refused.
    """
    for seed in range(tenth * PICKS // 10, (tenth + 1) * PICKS // 10):
        rng = np.random.default_rng(seed)
        speed, size, place = rng.uniform(0.05, 0.6), rng.uniform(0.03, 0.08, 3), rng.uniform(-0.5, 0.5)
        meet, along = rng.uniform(2.5, 4.0), rng.uniform(-0.5, 0.5)
        scene = Scene()
        scene.add("belt", Body.box([2.0, 8.0, 0.1]), translation(z=-0.05))

        def part_at(t, ahead=0.0, *, place=place, along=along, speed=speed, meet=meet, height=size[2]):
            return translation(place, along + ahead + speed * (t - meet), height / 2)

        for k, ahead in enumerate((0.0, 0.14, -0.14)):
            scene.add(f"part {k}", Body.box(size))
            scene.follow(f"part {k}", [0.0, 10.0], [part_at(0.0, ahead), part_at(10.0, ahead)])
        checker = CollisionChecker(picker, scene)
        still = np.array([0.0, speed, 0.0, 0.0])
        top, closed = size[2] / 2 + REACH, size[0] / 2
        above = np.array([place, along, top + HIGH, 0.06])
        home = np.array([*rng.uniform(-0.5, 0.5, 2), 0.6, 0.06])
        path = np.array([home, above - 0.3 * still, above])
        limits = {"velocity": FAST, "acceleration": STRONG}
        moved = planners.time_path(checker, path, start_time=0.0, arrive_at=meet, end_velocity=still, **limits)
        assert moved.certify(checker).verdict == Verdict.FREE
        assert (np.abs(moved.rates) <= FAST * (1 + 1e-9)).all()
        pushes = np.diff(moved.rates, axis=0) / np.diff(moved.times)[:, None]
        assert (np.abs(pushes) <= STRONG * (1 + 1e-9)).all()
        t = np.linspace(0.0, moved.duration, SAMPLES)
        assert not checker.collide(moved.positions(t), t).any()

        for finger in ("left", "right"):
            scene.reach("part 0", finger)
        low = np.array([place, along, top, 0.06])
        down, close, lift = meet + np.array([0.6, 1.0, 1.6])

        def following(opening, *, low=low, above=above, still=still, meet=meet, down=down, close=close):
            shut = np.append(low[:3], opening)
            rows = [[q + still * (t - meet), still, 0 * q] for q, t in ((above, meet), (low, down), (shut, close))]
            return curve_of([meet, down, close], rows)

        follow, held = following(closed), np.append(low[:3], closed) + still * (close - meet)
        np.testing.assert_allclose(moved.knots[-1], follow(meet), atol=1e-12)
        np.testing.assert_allclose(moved.rates[-1], follow.derivative()(meet), atol=1e-12)
        keeps_limits(follow)
        assert checker.certify_trajectory(follow).verdict == Verdict.FREE
        if seed % 10 == 0:
            assert checker.certify_trajectory(following(closed - TOO_DEEP)).verdict == Verdict.COLLIDING
        t = np.linspace(meet, close, SAMPLES)
        assert not checker.collide(follow(t[:-1]), t[:-1]).any()
        left, right, _ = gaps(follow, t, place, size)
        assert min(left.min(), right.min()) >= -ROUNDED
        assert max(left[-1], right[-1]) <= ROUNDED

        def lifting(dip, *, held=held, still=still, close=close, lift=lift):
            middle, lifted = (held + still * s + [0, 0, z, 0] for s, z in ((0.1, -dip), (lift - close, HIGH)))
            rows = [[held, still, 0 * held], [middle, still, 0 * held], [lifted, still, 0 * held]]
            return curve_of([close, close + 0.1, lift], rows) if dip else curve_of([close, lift], rows[::2])

        up, T = lifting(0.0), picker.forward_kinematics(held)[picker.link_names.index("palm")]
        touching = ["left", "right"]
        scene.attach("part 0", "palm", np.linalg.inv(T) @ part_at(close), touch_links=touching, leave=["belt"])
        keeps_limits(up)
        assert checker.certify_trajectory(up).verdict == Verdict.FREE
        if seed % 10 == 0:
            assert checker.certify_trajectory(lifting(TOO_DEEP)).verdict == Verdict.COLLIDING
        t = np.linspace(close, lift, SAMPLES)
        assert not checker.collide(up(t[1:]), t[1:]).any()
        _, _, over = gaps(up, t, place, size)
        assert abs(over[0]) <= ROUNDED
        assert (np.diff(over) > 0).all()
