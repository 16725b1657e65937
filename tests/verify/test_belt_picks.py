"""A thousand picks from belts: no contact at any time, and no joint beyond its limits."""

import numpy as np
import pytest
from scipy.interpolate import BPoly, PPoly

from families import translation
from loewner import Body, CollisionChecker, Robot, Scene, Verdict, planners

pytestmark = pytest.mark.verify

PICKS, SAMPLES = 1000, 501
FAST, STRONG = np.array([2.0, 2.0, 2.0, 0.5]), np.array([6.0, 6.0, 6.0, 3.0])

# From the gripper's origin to the middle of its fingers, its height over the parts, and what is left to a part [m].
REACH, HIGH, GAP = 0.125, 0.15, 2e-4

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


def curve_of(times, rows):
    """A curve of degree five with given positions, velocities and accelerations at given times."""
    return PPoly.from_bernstein_basis(BPoly.from_derivatives(times, rows))


@pytest.mark.parametrize("tenth", range(10))
def test_picks_from_a_belt(picker, tenth):
    """The robot meets the part at the belt's velocity, goes down with it, closes, and lifts it at this velocity."""
    for seed in range(tenth * PICKS // 10, (tenth + 1) * PICKS // 10):
        rng = np.random.default_rng(seed)
        speed, size, place = rng.uniform(0.05, 0.6), rng.uniform(0.03, 0.08, 3), rng.uniform(-0.5, 0.5)
        meet, along = rng.uniform(2.5, 4.0), rng.uniform(-0.5, 0.5)
        scene = Scene()
        scene.add("belt", Body.box([2.0, 8.0, 0.1]), translation(z=-0.051))

        def part_at(t, ahead=0.0, *, place=place, along=along, speed=speed, meet=meet, height=size[2]):
            return translation(place, along + ahead + speed * (t - meet), height / 2)

        for k, ahead in enumerate((0.0, 0.14, -0.14)):
            scene.add(f"part {k}", Body.box(size))
            scene.follow(f"part {k}", [0.0, 10.0], [part_at(0.0, ahead), part_at(10.0, ahead)])
        checker = CollisionChecker(picker, scene)
        still = np.array([0.0, speed, 0.0, 0.0])
        top, closed = size[2] / 2 + REACH, size[0] / 2 + GAP
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

        low, shut = above.copy(), above.copy()
        low[2], shut[2], shut[3] = top, top, closed
        down, close, lift = meet + np.array([0.6, 1.0, 1.6])
        rows = [[q + still * (t - meet), still, 0 * q] for q, t in ((above, meet), (low, down), (shut, close))]
        follow = curve_of([meet, down, close], rows)
        held = shut + still * (close - meet)
        lifted = held + still * (lift - close) + [0.0, 0.0, HIGH, 0.0]
        up = curve_of([close, lift], [[held, still, 0 * held], [lifted, still, 0 * held]])
        np.testing.assert_allclose(moved.knots[-1], follow(meet), atol=1e-12)
        np.testing.assert_allclose(moved.rates[-1], follow.derivative()(meet), atol=1e-12)
        for curve in (follow, up):
            if curve is up:
                T = picker.forward_kinematics(held)[picker.link_names.index("palm")]
                scene.attach("part 0", "palm", np.linalg.inv(T) @ part_at(close), touch_links=["left", "right"])
            speeds, pushes = largest(curve)
            assert (speeds <= FAST).all()
            assert (pushes <= STRONG).all()
            assert checker.certify_trajectory(curve).verdict == Verdict.FREE
            t = np.linspace(curve.x[0], curve.x[-1], SAMPLES)
            assert not checker.collide(curve(t), t).any()
