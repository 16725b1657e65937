"""Prove that a motion is free at every one of its configurations, by planes and not by samples.

A motion is cut into intervals, seven at a time. Over an interval of width w, every point of a body, relative to another
body, stays within A w² / 8 of its chord (`motion_bounds`). Let a plane be fixed in the frame of one body. If at both
ends the other body is beyond the plane by more than the margin plus A w² / 8, the plane proves the pair for the whole
interval.

cull
    Boxes about bodies in a whole block are compared first. Balls and boxes about swept bodies, boxes of trees over many
    pieces, and planes between ellipsoids follow, seven intervals at a time (`sweeps`). Pieces whose ellipsoids are deep
    in each other are tested immediately.
search
    `narrow.gjk_swept` searches for a plane between the pieces themselves, for each remaining piece pair. A plane that
    proves one interval is tried on the other intervals (`planes`).
test
    The exact answer is computed at both ends of an interval that is not proven.
halve
    Intervals that are still undecided are halved, until a plane or a collision is found, or no point moves by more than
    the tolerance. The plane that is best at both ends is tested at eight configurations in between. There, the bound is
    a 49th of the bound above, and where joints may stray, only their motion along the normal counts (`strays`).

All stages count their steps in a *tally*: placements, comparisons and searches. Every loop that is not bounded by a
constant, or by the numbers of bodies, ends when no steps are left.

docs/certified.md, "Motions", derives the bounds, and proves that the search ends.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import (
    AMBIGUOUS,
    BY_CARE,
    FREE,
    MAY_BE_HIT,
    MOST_INTERVALS,
    MOST_POINTS,
    NO_LIMIT,
    TOO_LONG,
    TOUCHING,
    UNFINISHED,
)
from loewner._kernels.columns import KIND, OUTER_RADIUS, SURFACE, SURFACE_AT, WIDE
from loewner._kernels.ellipsoids.contact import position_error
from loewner._kernels.linalg3 import negated
from loewner._kernels.narrow import exact, gjk_fast
from loewner._kernels.narrow.exact import exact_piece_pair
from loewner._kernels.narrow.gjk_robust import TOUCH_ROUNDINGS, run
from loewner._kernels.narrow.gjk_swept import separated
from loewner._kernels.narrow.surface_swept import triangles_apart
from loewner._kernels.pieces.pack import motion_tables_of, pieces_of, placed, problem_of, shift_between
from loewner._kernels.robots.kinematics import columns_of, link_entries, place_columns
from loewner._kernels.robots.motion_bounds import (
    VALUE_ROUNDINGS,
    Rates,
    rates_of,
    uncertainty,
    ways_between,
    write_strays,
)
from loewner._kernels.robots.motion_path import configurations_at, write_part
from loewner._kernels.robots.placement import DOF, LINKS, MOVING, MOVING_PIECES, PAIRS, STANDING, counts_of
from loewner._kernels.robots.planes import write_gaps
from loewner._kernels.robots.strays import error_of_strays, longest_lever, write_strays_along
from loewner._kernels.robots.sweeps import (
    BODY,
    EVERY,
    INTERVALS,
    PIECE,
    PLACED,
    PLACED_PIECES,
    WIDER,
    Swept,
    near_group,
    near_in_world,
    near_moving,
    near_piece,
    near_standing,
    place_body,
    place_pieces,
    see_piece,
    see_piece_standing,
    sweep,
    write_box,
)
from loewner._kernels.simd.memory import Arena, floats, floats_at, integers, raw
from loewner._kernels.simd.vectors import LANES, highest_bit, load, lowest_bit, movemask
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._kernels.trees.boxes import LEVELS
from loewner._kernels.trees.piece_tree import open_group, reach_of

# Largest deviation [m] of points from their chords that is allowed in the first intervals of a motion. The value is a
# choice, not an error bound.
FIRST_OFF = 0.02
MOST_BLOCKS = MOST_INTERVALS // 7

# Distance that pairs must keep in addition to their margins on a free motion, in rounding errors. It is slightly more
# than the distance at which `collide` may report contact, so `collide` reports no contact at any configuration of a
# free motion.
CLEAR_ROUNDINGS = TOUCH_ROUNDINGS + 64.0  # certified.md B32

# An unproven interval counts as AMBIGUOUS once no point moves by more than this fraction of the tolerance within it;
# `_enough` computes the exact limit. The rest of the tolerance is left for the convergence of the search.
DECIDED = 0.5

# If joints may stray, `_enough` uses the larger of the tolerance and SETTLED_STRAY times V(δ) (see docs/certified.md).
SETTLED_STRAY = 0.125

# Strays are treated as rounding errors if they move all points by less than ROUNDED_STRAY times the tolerance. This is
# the case for bodies that follow a motion.
ROUNDED_STRAY = 1e-3

# Maximum number of unproven intervals of a block that wait to be halved. When the list is full, all of them are halved.
WAITING = 256

# Maximum number of piece pairs of a block that wait to be searched, and number of floats for each of them, scalars
# first.
LISTED = 128
LISTED_WAYS = 6 * LANES
_NORMALS = LANES

# Maximum number of piece pairs with a surface whose answers are kept during a block, to be used for other parts of the
# same surface; and number of integers for each such pair.
ANSWERS, ANSWER = 64, 5

# Number of pairs of bodies that are tested before the bounds for a whole block are compared. Planners put the pairs
# that often collide first.
FIRST_PAIRS = 4

# Two pieces are tested immediately, at the configuration at which they are nearest, if the centers of their ellipsoids
# are then nearer to each other than DEEP times the distance at which the ellipsoids touch. Both distances are measured
# along the direction that `sweeps.near_piece` writes. Most such pieces collide.
DEEP = 0.7

PARTS = 8  # Number of parts into which a cut divides an interval.

# Factors by which the work for triangles may grow: MORE after two nested cuts, and MOST_MORE after three or more cuts,
# or if no cut follows.
MORE, MOST_MORE = 8, 64

# Maximum number of nested cuts. A cut divides an interval's width by eight, and fractions of 1 have 53 bits, so after
# seventeen cuts an interval can be too narrow for another cut.
DEPTH = 19
STACK = 4 * DEPTH  # Three halvings lead to a part of a cut, and each halving leaves one half waiting.

_POSES = 2 * (PARTS + 1)

# Indices of a tally's entries: the numbers of placed configurations, of searches, and of remaining steps. Each placed
# configuration and each search counts as one step. In a block, each of the following also counts as one step: a moving
# body, a group of static bodies, a pair of bodies that may be near each other, a placed piece, a pair of pieces, and a
# group of boxes around pieces. A walk through surfaces takes one step for each box, triangle or point that it visits.
POSES, SEARCHES, STEPS_LEFT = 0, 1, 2


class Motion(NamedTuple):
    """A query about one motion, and its memory.

    Attributes
    ----------
    pack, problem, tables : handles of the pieces, the problem and `records.MotionTables`
    tolerance : m
    rounding : errors of computed poses, and rounding of the positions of the robot's points [m]
    skew : relative error of turned lengths, which also enlarges the margin of a pair
    strays : whether values may deviate from the course; pairs then keep a larger distance
    clear : distance that pairs must keep in addition to their margins [m]
    as_given : whether COLLIDING refers to the given places of bodies, however far their points may be off
    points : control points of the course
    counts : numbers of bodies, pieces, pairs and links
    work : address of `MEMORY`
    """

    pack: Any
    problem: Any
    tables: Any
    tolerance: Any
    rounding: Any
    skew: Any
    strays: Any
    clear: Any
    as_given: Any
    points: Any
    counts: Any
    work: Any


class Near(NamedTuple):
    """Two pieces of a pair of bodies, with bounds on their motion.

    Attributes
    ----------
    pair : number of the pair of bodies
    i, j : the pieces; i moves
    bend, speed : `Ways` of i relative to j
    margin, rise : distance that the pieces must keep at the start of the motion, and its growth until the end [m]
    slack : bound on rounding and on how far joints may stray from the course [m]
    stray : the part of `slack` that is due to joints that stray
    lever, wave, rest : `longest_lever`, and the errors of strays along a normal: less than wave w² + rest. All are 0
        if joints do not stray, and until they are first needed.
    """

    pair: Any
    i: Any
    j: Any
    bend: Any
    speed: Any
    margin: Any
    rise: Any
    slack: Any
    stray: Any
    lever: Any
    wave: Any
    rest: Any


# -- memory -----------------------------------------------------------------------------------


_LINK_ENTRIES = link_entries(LINKS, DOF)

_RATES = Arena(Rates, **{name: floats(LINKS) for name in Rates._fields})

MEMORY = Arena(
    times=floats(LANES),  # Times of the block.
    scratch=floats(PIECE),  # Center and shape of a piece as seen from another body.
    box=floats(6),  # Box around a piece at the eight configurations of a block, in the frame of another body.
    tree_stack=integers(LEVELS * WIDE),  # Groups and pieces that remain to be compared, from a tree over pieces.
    near_pairs=integers(PAIRS),  # 0 for pairs with a static body that are apart in the block; otherwise 1.
    # Piece pairs to search: pair of bodies, pieces i and j, masks of intervals and of tested configurations.
    listed=integers(LISTED, 5),
    # Other numbers of `Near` for these pairs, and the results of `sweeps.near_piece`.
    listed_ways=floats(LISTED * LISTED_WAYS),
    answers=integers(ANSWERS, ANSWER),  # See `_row_of_answers`.
    relative=floats(4, 4, 4),  # The identity, and two poses of a body relative to another body.
    # Intervals to halve: row of the pair in `listed`, number of the interval, and whether it is undecided.
    waiting=integers(WAITING, 3),
    waiting_normals=floats(WAITING, 3),
    cut_times=floats(DEPTH, PARTS + 1),  # Times at which intervals are cut, for each depth.
    # Poses at these times, for each depth: first the poses of one body, then the poses of the other body.
    cut_poses=floats(DEPTH * _POSES, 4, 4),
    # Poses at both ends of an interval to be halved: first the poses of one body, then the poses of the other body.
    ends=floats(4, 4, 4),
    stack=integers(STACK, 3),  # Parts to halve: depth, and indices of the first and the last time.
    stack_normals=floats(STACK, 3),
    gjk=gjk_fast.MEMORY,
    exact=raw(exact.SIZE),
    vectors=floats(3, 4),  # The careful search uses this field and the next one.
    simplex=floats(4, 9),
    course=raw(8 * MOST_POINTS * DOF),
    part=raw(8 * MOST_POINTS * DOF),  # Control points of the part of the course in a block.
    scratch_points=floats(MOST_POINTS),  # Scratch for `write_part`.
    part_times=floats(LANES),  # Eight fractions; `gaps` holds the gaps at these fractions.
    gaps=floats(4 * LANES),
    planes=floats((2 + 4 * LINKS) * LANES),  # See `strays`.
    cut_links=floats(_LINK_ENTRIES),  # Placed links in an interval that is cut, see `kinematics`.
    rates=_RATES,
    ways=floats(MOVING, 3),  # `bend`, `speed` and V(δ) of moving bodies, relative to the world.
    swept=Arena(
        Swept, poses=floats(LANES * MOVING, 4, 4), bodies=floats(BODY * MOVING), pieces=floats(PIECE * MOVING_PIECES),
        done=integers(MOVING), links=floats(_LINK_ENTRIES), numbers=integers(LANES),
    ),  # Placement of a block.
    order=integers(PAIRS),  # Order of the pairs.
    off=floats(DOF),  # How far the values of a configuration may deviate from the motion.
    strays=_RATES,  # Deviations of the joints, computed from `off`.
    # How far points of bodies may be off at the start [m], and how much this distance grows until the end.
    growth=floats(MOVING + STANDING, 2),
    # For static bodies, the largest distance at the start, and how much the largest distance grows until the end; and
    # whether any body may be off.
    most_growth=floats(3),
)  # fmt: skip
_times_of, _scratch_of, _relative_of, _waiting_of, _waiting_normals_of = MEMORY.accessors(
    "times scratch relative waiting waiting_normals"
)
_cut_times_of, _cut_poses_of, _stack_of, _stack_normals_of, _gjk_of, _exact_of = MEMORY.accessors(
    "cut_times cut_poses stack stack_normals gjk exact"
)
_vectors_of, _simplex_of, _course_at, _part_at, _scratch_points_of = MEMORY.accessors(
    "vectors simplex course part scratch_points"
)
_cut_links_of, _rates_of, _ways_of, _swept_of, _order_of, _off_of, _strays_of = MEMORY.accessors(
    "cut_links rates ways swept order off strays"
)
_gaps_of, _planes_of, _part_times_of, _ends_of, _near_pairs_of, _listed_of, _listed_ways_of = MEMORY.accessors(
    "gaps planes part_times ends near_pairs listed listed_ways"
)
_box_of, _tree_stack_of = MEMORY.accessors("box tree_stack")
_answers_of, _growth_of, _most_growth_of = MEMORY.accessors("answers growth most_growth")
_size = MEMORY.sizing()


@inline
def _course_of(motion):
    return floats_at(_course_at(motion), (motion.points, motion.counts.dof))


@inline
def _part_of(motion):
    return floats_at(_part_at(motion), (motion.points, motion.counts.dof))


@njit()
def motion_memory(pack, problem_handle, dof):
    """Number of scratch bytes for `certify_motions`, for courses of up to `MOST_POINTS` control points."""
    return _size(counts_of(pieces_of(pack), problem_of(problem_handle), dof))


# -- single questions ---------------------------------------------------------------------------


@inline
def _standing_poses(problem):
    """Poses of static bodies, as an array with the shape of other poses."""
    return floats_at(problem.standing_poses.ctypes.data, (len(problem.standing_poses), 4, 4))


@inline
def _relative(frames, fixed, poses, row, to, k):
    """Write to row k of `to` the pose in a row of `poses`, relative to the pose in row `fixed` of `frames`."""
    for r in range(3):
        for c in range(3):
            to[k, r, c] = (
                frames[fixed, 0, r] * poses[row, 0, c]
                + frames[fixed, 1, r] * poses[row, 1, c]
                + frames[fixed, 2, r] * poses[row, 2, c]
            )
        to[k, r, 3] = (
            frames[fixed, 0, r] * (poses[row, 0, 3] - frames[fixed, 0, 3])
            + frames[fixed, 1, r] * (poses[row, 1, 3] - frames[fixed, 1, 3])
            + frames[fixed, 2, r] * (poses[row, 2, 3] - frames[fixed, 2, 3])
        )


@apart
def _proven_standing(motion, i, poses, first, last, j, still, row, least, keep, n):
    """Apply `separated` to piece i at two poses and the static piece j; n is from j to i."""
    pieces, tables = pieces_of(motion.pack), motion_tables_of(motion.tables)
    return separated(
        placed(pieces, j, still, row), placed(pieces, i, poses, first), placed(pieces, i, poses, last), n, least, keep,
        2.0 * tables.chain[2], _gjk_of(motion),
    )  # fmt: skip


@njit()
def _proven_moving(motion, i, j, poses, fixed_first, first, fixed_last, last, least, keep, n):
    """Apply `separated` to two moving pieces, relative to the body of j; n is from j to i."""
    to = _relative_of(motion)
    _relative(poses, fixed_first, poses, first, to, 1)
    _relative(poses, fixed_last, poses, last, to, 2)
    return _proven_standing(motion, i, to, 1, 2, j, to, 0, least, keep, n)


@inline
def _row_of_answers(motion, near):
    """Return the row of `answers` for two pieces; -1 if neither is a surface.

    All parts of a surface have the same answers, because these are computed with all triangles of the surface. A row
    holds the pair of bodies, the two surfaces or pieces, the intervals of the block that are settled (as bits), and the
    configurations that have been tested (as bits). A further bit of the intervals marks that all intervals have been
    tried as one.
    """
    layout = pieces_of(motion.pack).layout
    i_is, j_is = layout[near.i, KIND] <= SURFACE, layout[near.j, KIND] <= SURFACE
    if not (i_is or j_is):
        return -1
    one, other = layout[near.i, SURFACE_AT] if i_is else ~near.i, layout[near.j, SURFACE_AT] if j_is else ~near.j
    answers, row = _answers_of(motion), (near.pair + (one >> 4) + 7 * (other >> 4) + one + other) & (ANSWERS - 1)
    if answers[row, 0] != near.pair or answers[row, 1] != one or answers[row, 2] != other:
        answers[row, 0], answers[row, 1], answers[row, 2], answers[row, 3], answers[row, 4] = (
            near.pair,
            one,
            other,
            0,
            0,
        )
    return row


@apart
def _triangles_apart(
    motion, near, back, margin, width, times, poses, first, last, still, fixed_first, fixed_last, tally
):
    """Return whether two pieces are proven apart in an interval, if one of them is a surface or a part of a surface.

    Parameters
    ----------
    near : Near
    back : Ways
        `Ways` of j relative to i.
    margin, width : float
        The pair's `_margin_within` the interval, and the interval's length.
    times : int
        Documented in `triangles_apart`.
    poses, first, last :
        Poses in the world, and the rows with the poses of i's body at both ends.
    still, fixed_first, fixed_last :
        Poses in the world, and the rows with the poses of j's body at both ends.
    """
    pieces, i, j, to = pieces_of(motion.pack), near.i, near.j, _relative_of(motion)
    bend, speed, stands = near.bend, near.speed, problem_of(motion.problem).pairs[near.pair, 1] >= motion.counts.moving
    if pieces.layout[j, KIND] > SURFACE:  # Work in the frame of the surface.
        if pieces.layout[i, KIND] > SURFACE:
            return False
        i, j, bend, speed, stands = j, i, back.bend, back.speed, False
        poses, first, last, still, fixed_first, fixed_last = still, fixed_first, fixed_last, poses, first, last
    if not stands:  # For a static body, stay in the world frame, because the body's own might not be orthonormal.
        _relative(still, fixed_first, poses, first, to, 1)
        _relative(still, fixed_last, poses, last, to, 2)
        poses, first, last, still, fixed_first = to, 1, 2, to, 0
    proven, taken = triangles_apart(
        placed(pieces, j, still, fixed_first), placed(pieces, i, poses, first), placed(pieces, i, poses, last),
        margin + near.slack + bend * width * width / 8.0, 2.0 * motion_tables_of(motion.tables).chain[2],
        speed * width, times, _allowed(tally), _gjk_of(motion), _exact_of(motion),
    )  # fmt: skip
    tally[STEPS_LEFT] -= taken
    return proven


@apart
def _collides(motion, i, poses, row, j, others, other_row, margin, n, tally):
    """Decide whether two pieces are within the margin, at poses in the world; n is from i to j.

    Returns COLLIDING, BY_CARE if only the careful search finds the pieces touching, or FREE, which proves nothing.
    """
    _count(tally, SEARCHES, 1)
    verdict, _, taken = exact_piece_pair(
        motion.pack, i, poses, row, motion.pack, j, others, other_row, margin, n, _allowed(tally), _exact_of(motion)
    )
    tally[STEPS_LEFT] -= taken
    if verdict == AMBIGUOUS and tally[STEPS_LEFT] < 0:
        verdict = FREE
    if verdict == AMBIGUOUS:
        pieces, V = pieces_of(motion.pack), _vectors_of(motion)
        A, B = placed(pieces, i, poses, row), placed(pieces, j, others, other_row)
        touching, _, _, _ = run(A, B, shift_between(A, B), n, margin, True, _simplex_of(motion), V[0], V[1], V[2])
        verdict = BY_CARE if touching == TOUCHING else FREE
    return verdict


@apart
def _hits(motion, near, t, poses, row, others, other_row, n, tally):
    """Test two pieces as `_collides` does, with the margin at t; MAY_BE_HIT if only bodies off their places collide."""
    margin, own = _margin_at(near, t), problem_of(motion.problem).margins[near.pair] + motion.clear
    hit = _collides(motion, near.i, poses, row, near.j, others, other_row, margin, n, tally)
    if hit != FREE and motion.as_given and margin > own:
        hit = _collides(motion, near.i, poses, row, near.j, others, other_row, own, n, tally)
        return MAY_BE_HIT if hit == FREE else hit
    return hit


@inline
def _count(tally, entry, number):
    """Count placed configurations or searches."""
    tally[entry] += number
    tally[STEPS_LEFT] -= number


@inline
def _allowed(tally):
    """Number of steps that a walk may take: one more than are left, so the number left ends below 0 if they run out."""
    return max(tally[STEPS_LEFT] + 1, 0)


@inline
def _to_world(poses, row, n):
    """Transform a direction from a body's frame to the world."""
    return (
        poses[row, 0, 0] * n[0] + poses[row, 0, 1] * n[1] + poses[row, 0, 2] * n[2],
        poses[row, 1, 0] * n[0] + poses[row, 1, 1] * n[1] + poses[row, 1, 2] * n[2],
        poses[row, 2, 0] * n[0] + poses[row, 2, 1] * n[1] + poses[row, 2, 2] * n[2],
    )


@inline
def _to_body(poses, row, n):
    """Transform a direction from the world to a body's frame."""
    return (
        poses[row, 0, 0] * n[0] + poses[row, 1, 0] * n[1] + poses[row, 2, 0] * n[2],
        poses[row, 0, 1] * n[0] + poses[row, 1, 1] * n[1] + poses[row, 2, 1] * n[2],
        poses[row, 0, 2] * n[0] + poses[row, 1, 2] * n[1] + poses[row, 2, 2] * n[2],
    )


@inline
def _off_together(motion, pair):
    """How far points of two bodies may be off [m]: at the start of the motion, and by how much the distance grows."""
    problem, growth = problem_of(motion.problem), _growth_of(motion)
    one, other = problem.pairs[pair, 0], problem.pairs[pair, 1]
    return growth[one, 0] + growth[other, 0], growth[one, 1] + growth[other, 1]


@inline
def _margin(motion, pair):
    """Distance that two bodies must keep [m]: at the start of the motion, and by how much it grows until the end."""
    off, rise = _off_together(motion, pair)
    return problem_of(motion.problem).margins[pair] + motion.clear + off, rise


@inline
def _margin_at(near, t):
    """Distance that two pieces must keep at a fraction of the motion."""
    return near.margin + near.rise * t


@inline
def _margin_within(near, low, high):
    """Largest distance that two pieces must keep from one fraction of the motion to another."""
    return near.margin + max(near.rise * low, near.rise * high)


@inline
def _enough(motion, near):
    """Largest motion of points [m] in an interval that counts as settled; see docs/certified.md."""
    slack = near.slack - near.stray
    return DECIDED * max(motion.tolerance - slack, slack, SETTLED_STRAY * near.stray)


@inline
def _off(near, width):
    """Largest distance of points from their chords in an interval."""
    return near.bend * width * width / 8.0


@inline
def _needed(near, margin, width):
    """Gap [m] along a normal, less strays, that suffices to prove an interval with this margin."""
    return margin + (near.slack - near.stray) + _off(near, width) + (near.wave * width * width + near.rest)


@inline
def _kept(near, low, high):
    """Gap [m] that proves an interval for strays in any direction; and the least gap that may prove a seventh of it."""
    keep = _margin_within(near, low, high) + near.slack + _off(near, high - low)
    least = near.margin + min(near.rise * low, near.rise * high)
    return keep, min(_needed(near, least, (high - low) / INTERVALS), keep)


@inline
def _moved(near, width):
    """Largest distance of the hull of both ends from the piece in the middle, plus the change of the margin."""
    return near.speed * width / 2.0 + _off(near, width) + abs(near.rise) * width


@inline
def _write_gaps(motion, near, W, n, directed):
    """Write the gaps along n at the eight configurations of W, less strays along n if `directed`."""
    pieces, problem, tables = pieces_of(motion.pack), problem_of(motion.problem), motion_tables_of(motion.tables)
    one, other, moving = problem.pairs[near.pair, 0], problem.pairs[near.pair, 1], motion.counts.moving
    still, link, fixed, row = _standing_poses(problem), problem.link[one], -1, other - moving
    if other < moving:
        fixed, row = problem.link[other], 0
    strays, gaps, count = _planes_of(motion), _gaps_of(motion), -1
    if directed:
        off = _strays_of(motion)
        count = write_strays_along(
            problem.tree, tables, pieces.hot, W, off, near.lever, link, fixed, near.i, n, strays
        )  # fmt: skip
    write_gaps(pieces, W, link, fixed, still, row, near.i, near.j, n, strays, count, gaps)


@apart
def _open_parts(motion, near, W, times, n, directed):
    """Bits of the intervals between eight configurations that a plane with the normal n does not prove.

    The normal is in the frame of j's body; `directed` is explained at `_write_gaps`.
    """
    gaps, widest = _gaps_of(motion), 0.0
    for k in range(INTERVALS):
        widest = max(widest, times[k + 1] - times[k])
    _write_gaps(motion, near, W, n, directed)
    needed = _needed(near, near.margin, widest) + (0.0 if directed else near.stray)
    clear = movemask(load(gaps, 0) > load(times, 0) * near.rise + needed)
    return EVERY & ~(clear & (clear >> 1))


@njit()
def _open_between(motion, near, low, high, n):
    """Bits of the seven parts of an interval that a plane with the normal n does not prove."""
    W, times = _cut_links_of(motion), _part_times_of(motion)
    _place_between(motion, low, high, times, W)
    return _open_parts(motion, near, W, times, n, near.stray > 0.0)


@apart
def _place_between(motion, low, high, times, W):
    """Place the links at eight times from `low` to `high`, and write the times; return the longest interval."""
    widest = 0.0
    for k in range(LANES):
        times[k] = low + (high - low) * (k / INTERVALS) if k < INTERVALS else high
        if k > 0:
            widest = max(widest, times[k] - times[k - 1])
    _place_at(motion, times, 0, W)
    return widest


@apart
def _ways(motion, astray, body, link, fixed):
    """`Ways` of a body relative to a link: on the course, or on the way to deviations from it if `astray`."""
    tables = motion_tables_of(motion.tables)
    return ways_between(tables, _strays_of(motion) if astray else _rates_of(motion), body, link, fixed)


@apart
def _place_at(motion, times, first, W):
    """Place the links at eight times, starting at entry `first`."""
    tree = problem_of(motion.problem).tree
    configurations_at(tree, _course_of(motion), times, first, columns_of(tree, W))
    place_columns(tree, W)


@inline
def _copy_pose(W, link, lane, poses, row):
    """Copy a link's pose from one lane to a row."""
    at = link * 12 * LANES + lane
    for r in range(3):
        for c in range(3):
            poses[row, r, c] = W[at + (3 * r + c) * LANES]
        poses[row, r, 3] = W[at + (9 + r) * LANES]


@njit()
def _copy_pair(motion, near, W, lane, poses, row, other_row):
    """Copy the poses of a pair's bodies from one lane to two rows."""
    problem = problem_of(motion.problem)
    other = problem.pairs[near.pair, 1]
    _copy_pose(W, problem.link[problem.pairs[near.pair, 0]], lane, poses, row)
    if other < motion.counts.moving:
        _copy_pose(W, problem.link[other], lane, poses, other_row)
    else:
        for entry in range(12):
            poses[other_row, entry // 4, entry % 4] = problem.standing_poses[other - motion.counts.moving, entry]


@apart
def _sweep(motion, body):
    """Write the bounds of a moving body in a block."""
    sweep(problem_of(motion.problem), pieces_of(motion.pack), body, _swept_of(motion))


@apart
def _place_pieces(motion, body):
    """Place the pieces of a moving body in a block."""
    place_pieces(problem_of(motion.problem), pieces_of(motion.pack), body, _swept_of(motion))


@apart
def _place_body(motion, body):
    """Write the poses of a moving body in a block."""
    place_body(problem_of(motion.problem), body, _swept_of(motion))


# -- halving ------------------------------------------------------------------------------------


@njit()
def _cut(motion, near, depth, low, high, poses, row_low, row_high, others, other_low, other_high):
    """Write, at a depth, the times and poses that cut an interval into eight parts; the end poses are copied."""
    times, to, W = _cut_times_of(motion)[depth], _cut_poses_of(motion), _cut_links_of(motion)
    for k in range(PARTS):
        times[k] = low + (high - low) * (k / PARTS)
    times[PARTS] = high
    _place_at(motion, times, 1, W)
    at = depth * _POSES
    both = at + PARTS + 1
    for row in range(at, at + _POSES):
        for c in range(4):
            to[row, 3, c] = 0.0
    for r in range(3):
        for c in range(4):
            to[at, r, c], to[at + PARTS, r, c] = poses[row_low, r, c], poses[row_high, r, c]
            to[both, r, c], to[both + PARTS, r, c] = others[other_low, r, c], others[other_high, r, c]
    for k in range(1, PARTS):
        _copy_pair(motion, near, W, k - 1, to, at + k, both + k)


@njit()
def _write_ends(motion, near, W, first, last):
    """Copy the poses of a pair's bodies in two lanes of W, for `_halve`."""
    _copy_pair(motion, near, W, first, _ends_of(motion), 0, 2)
    _copy_pair(motion, near, W, last, _ends_of(motion), 1, 3)


@apart
def _test_middle(motion, near, t, width, poses, row, other_row, toward, tally):
    """Test two pieces exactly at t, in the middle of an interval; return FREE, or the verdict for the interval.

    The verdict is AMBIGUOUS if the pieces come within the tolerance and points stay within the tolerance of their
    chords.
    """
    hit = _hits(motion, near, t, poses, row, poses, other_row, toward, tally)
    if hit == FREE and _off(near, width) <= motion.tolerance:
        wide = _margin_at(near, t) + motion.tolerance
        if _collides(motion, near.i, poses, row, near.j, poses, other_row, wide, toward, tally) != FREE:
            return AMBIGUOUS
    return hit


@njit()
def _halve(motion, near, back, low, high, n, tally):
    """Settle an interval that no plane between its ends proves; the poses at both ends must have been written.

    Parameters
    ----------
    near : Near
    back : Ways
        `Ways` of j relative to i.
    n : tuple of 3 float
        Direction from j to i, in the frame of j's body.
    tally : ndarray of int64
        Counts the steps.

    Returns
    -------
    verdict : int
    t : float
        Fraction at which the interval is COLLIDING, AMBIGUOUS or UNFINISHED.
    by_triangles : bool
        Whether the interval is FREE because all triangles of the surfaces, including their other parts, are apart.
    """
    problem, by_triangles, has_surface = problem_of(motion.problem), True, _row_of_answers(motion, near) >= 0
    stands = problem.pairs[near.pair, 1] >= motion.counts.moving
    times, poses, part, ends = (
        _cut_times_of(motion), _cut_poses_of(motion), _part_times_of(motion), _ends_of(motion),
    )  # fmt: skip
    stack, normals = _stack_of(motion), _stack_normals_of(motion)
    _cut(motion, near, 0, low, high, ends, 0, 1, ends, 2, 3)
    _count(tally, POSES, LANES)
    enough = _enough(motion, near)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, PARTS
    normals[0, 0], normals[0, 1], normals[0, 2] = n
    top = 1
    while top > 0:
        top -= 1
        depth, first, last = stack[top, 0], stack[top, 1], stack[top, 2]
        n = normals[top, 0], normals[top, 1], normals[top, 2]
        if tally[STEPS_LEFT] < 0:
            return UNFINISHED, times[depth, first], False
        if last - first == 1:
            a, b = times[depth, first], times[depth, last]
            if depth + 1 >= DEPTH or not (a < a + (b - a) / PARTS < a + (b - a) * (1.0 - 1.0 / PARTS) < b):
                return AMBIGUOUS, a, False  # The two times are too close together for another cut.
            at = depth * _POSES
            both = at + PARTS + 1
            _cut(motion, near, depth + 1, a, b, poses, at + first, at + last, poses, both + first, both + last)
            _count(tally, POSES, LANES)
            depth, first, last = depth + 1, 0, PARTS
        at = depth * _POSES
        both = at + PARTS + 1
        middle = (first + last) // 2
        t, width = times[depth, middle], times[depth, last] - times[depth, first]
        toward = negated(n if stands else _to_world(poses, both + middle, n))
        # The exact test of surfaces takes longer than tests with planes, so it is run only after the planes have
        # failed.
        waits = has_surface
        if not waits:
            hit = _test_middle(motion, near, t, width, poses, at + middle, both + middle, toward, tally)
            if hit != FREE:
                return hit, t, False
        for half in range(2):
            a, b = (middle, last) if half == 0 else (first, middle)
            w = times[depth, b] - times[depth, a]
            keep, least = _kept(near, times[depth, a], times[depth, b])
            _count(tally, SEARCHES, 1)
            if stands:
                proven, m, undecided = _proven_standing(
                    motion, near.i, poses, at + a, at + b, near.j, poses, both + a, least, keep, n
                )  # fmt: skip
            else:
                proven, m, undecided = _proven_moving(
                    motion, near.i, near.j, poses, both + a, at + a, both + b, at + b, least, keep, n
                )  # fmt: skip
            left = EVERY
            if not proven and undecided:
                _count(tally, POSES, LANES)
                left = _open_between(motion, near, times[depth, a], times[depth, b], m)
            if proven or left == 0:
                by_triangles = False
                continue
            # Try a plane that is fixed to the other body and turns with it.
            within = _margin_within(near, times[depth, a], times[depth, b])
            keep = within + near.slack + back.bend * w * w / 8.0
            world = m if stands else _to_world(poses, both + a, m)
            _count(tally, SEARCHES, 1)
            is_apart, _, _ = _proven_moving(
                motion, near.j, near.i, poses, at + a, both + a, at + b, both + b, keep, keep,
                _to_body(poses, at + a, negated(world)),
            )  # fmt: skip
            if is_apart:
                by_triangles = False
                continue
            more = MOST_MORE if depth > 1 or _moved(near, w) <= enough else MORE**depth
            if _triangles_apart(
                motion, near, back, within, w, more, poses, at + a, at + b, poses, both + a, both + b, tally
            ):
                continue
            if waits:
                waits = False
                hit = _test_middle(motion, near, t, width, poses, at + middle, both + middle, toward, tally)
                if hit != FREE:
                    return hit, t, False
            if _moved(near, w) <= enough:
                return AMBIGUOUS, 0.5 * (times[depth, a] + times[depth, b]), False
            if left != EVERY:
                by_triangles = False
                while a + 1 < b and times[depth, a + 1] <= part[lowest_bit(left)]:
                    a += 1
                while a < b - 1 and times[depth, b - 1] >= part[highest_bit(left) + 1]:
                    b -= 1
            stack[top, 0], stack[top, 1], stack[top, 2] = depth, a, b
            normals[top, 0], normals[top, 1], normals[top, 2] = m
            top += 1
    return FREE, np.nan, by_triangles


# -- a block ------------------------------------------------------------------------------------


class Found(NamedTuple):
    """The worst result for a motion so far: its verdict, fraction, and pair of bodies."""

    verdict: Any
    t: Any
    pair: Any


@inline
def _worse(found, verdict, t, pair):
    """Merge another verdict into the worst result so far; on a tie, the earlier result stays."""
    if verdict == FREE or found.verdict == verdict or (verdict == AMBIGUOUS and found.verdict != FREE):
        return found
    return Found(verdict, t, pair)


@inline
def _hit(found):
    """Return whether the search ends, because no result is worse, no steps are left, or the block is begun again."""
    return not (found.verdict == FREE or found.verdict == AMBIGUOUS)


@inline
def _open_verdict(motion):
    """Verdict for an interval that is not proven and in which no collision was found."""
    return MAY_BE_HIT if motion.as_given and _most_growth_of(motion)[2] != 0.0 else AMBIGUOUS


@njit()
def _halve_waiting(motion, count, found, tally):
    """Settle all waiting intervals, until a collision is found."""
    problem, swept, answers = problem_of(motion.problem), _swept_of(motion), _answers_of(motion)
    waiting, normals, times, part = (
        _waiting_of(motion), _waiting_normals_of(motion), _times_of(motion), _part_times_of(motion),
    )  # fmt: skip
    for e in range(count):
        near, k = _with_errors(motion, waiting[e, 0]), waiting[e, 1]
        pair, row = near.pair, _row_of_answers(motion, near)
        if row >= 0 and (answers[row, 3] >> k) & 1 != 0:
            continue
        if tally[STEPS_LEFT] < 0:
            return Found(UNFINISHED, times[k], pair)
        one, other = problem.pairs[pair, 0], problem.pairs[pair, 1]
        link = problem.link[other] if other < motion.counts.moving else -1
        back = _ways(motion, False, other, link, problem.link[one])
        n = normals[e, 0], normals[e, 1], normals[e, 2]
        keep, least = _kept(near, times[k], times[k + 1])
        proven, undecided = False, waiting[e, 2] != 0
        if near.stray == 0.0:  # With strays, the best plane has already been found.
            _count(tally, SEARCHES, 1)
            proven, n, undecided = _proven(motion, near, swept, k, k + 1, least, keep, n)
        left = EVERY
        if not proven and undecided:
            _count(tally, POSES, LANES)
            left = _open_between(motion, near, times[k], times[k + 1], n)
        if proven or left == 0:
            continue
        if _moved(near, times[k + 1] - times[k]) <= _enough(motion, near):
            if row >= 0 and _apart_in_block(motion, near, k, k + 1, MOST_MORE, tally):
                answers[row, 3] |= 1 << k
                continue
            found = _worse(found, _open_verdict(motion), 0.5 * (times[k] + times[k + 1]), pair)
            if _hit(found):
                break
            continue
        low, high = times[k], times[k + 1]
        if left == EVERY:
            _write_ends(motion, near, swept.links, k, k + 1)
        else:
            first, last = lowest_bit(left), highest_bit(left) + 1
            low, high = part[first], part[last]
            _write_ends(motion, near, _cut_links_of(motion), first, last)
        verdict, t, by_triangles = _halve(motion, near, back, low, high, n, tally)
        found = _worse(found, _open_verdict(motion) if verdict == AMBIGUOUS else verdict, t, pair)
        if row >= 0 and (verdict == AMBIGUOUS or (by_triangles and left == EVERY)):
            answers[row, 3] |= 1 << k
        if _hit(found):
            break
    return found


@apart
def _settled_by_triangles(motion, near, k, is_first, tally):
    """Bits of the block's intervals in which the triangles of two pieces are proven apart: all intervals, or only k.

    If `is_first`, all intervals are first tried as a single interval; a further bit marks this attempt.
    """
    mark = 1 << INTERVALS if is_first else 0
    if is_first and _apart_in_block(motion, near, 0, INTERVALS, 1, tally):
        return EVERY | mark
    return mark | (_apart_in_block(motion, near, k, k + 1, 1, tally) << k)


@inline
def _apart_in_block(motion, near, first, last, more, tally):
    """Call `_triangles_apart` between two configurations of the block."""
    problem, swept, times = problem_of(motion.problem), _swept_of(motion), _times_of(motion)
    one, other = problem.pairs[near.pair, 0], problem.pairs[near.pair, 1]
    moves = other < motion.counts.moving
    back = _ways(motion, False, other, problem.link[other] if moves else -1, problem.link[one])
    a, still, b, step = one * LANES, _standing_poses(problem), other - motion.counts.moving, 0
    if moves:
        still, b, step = swept.poses, other * LANES, 1
    return _triangles_apart(
        motion, near, back, _margin_within(near, times[first], times[last]), times[last] - times[first], more,
        swept.poses, a + first, a + last, still, b + first * step, b + last * step, tally,
    )  # fmt: skip


@inline
def _proven(motion, near, swept, first, last, least, keep, n):
    """Call `_proven_standing` or `_proven_moving` for the configurations `first` and `last` of the block."""
    problem = problem_of(motion.problem)
    one, other = problem.pairs[near.pair, 0], problem.pairs[near.pair, 1]
    a, b = one * LANES + first, one * LANES + last
    if other >= motion.counts.moving:
        still, row = _standing_poses(problem), other - motion.counts.moving
        return _proven_standing(motion, near.i, swept.poses, a, b, near.j, still, row, least, keep, n)
    o = other * LANES
    return _proven_moving(motion, near.i, near.j, swept.poses, o + first, a, o + last, b, least, keep, n)


@inline
def _collides_in_block(motion, near, swept, k, n, tally):
    """Test whether two pieces collide at configuration k of the block; n is from j to i, in j's frame."""
    problem = problem_of(motion.problem)
    one, other = problem.pairs[near.pair, 0], problem.pairs[near.pair, 1]
    a, t = one * LANES + k, _times_of(motion)[k]
    if other >= motion.counts.moving:
        still = _standing_poses(problem)
        s = other - motion.counts.moving
        return _hits(motion, near, t, swept.poses, a, still, s, negated(n), tally)
    o = other * LANES + k
    return _hits(motion, near, t, swept.poses, a, swept.poses, o, negated(_to_world(swept.poses, o, n)), tally)


@inline
def _test(motion, near, swept, k, n, found, tested, tally):
    """Test only once whether two pieces collide at configuration k of the block; n is from j to i, in j's frame.

    Returns
    -------
    found : Found
    tested : int
        Bits of the configurations that were tested.
    """
    if (tested >> k) & 1 == 0:
        tested |= 1 << k
        found = _worse(found, _collides_in_block(motion, near, swept, k, n, tally), _times_of(motion)[k], near.pair)
    return found, tested


@njit()
def _search(motion, e, found, waiting_count, tally):
    """Prove the intervals of a listed piece pair by planes; the remaining intervals wait to be halved.

    Returns
    -------
    found : Found
    waiting_count : int
    """
    swept, times, waiting, normals = (
        _swept_of(motion), _times_of(motion), _waiting_of(motion), _waiting_normals_of(motion),
    )  # fmt: skip
    near, N, at, gaps = (
        _listed_pair(motion, e), _listed_ways_of(motion), e * LISTED_WAYS + _NORMALS, _gaps_of(motion),
    )  # fmt: skip
    live, tested = _listed_of(motion)[e, 3], _listed_of(motion)[e, 4]
    answers, row = _answers_of(motion), _row_of_answers(motion, near)
    if row >= 0:
        live &= ~answers[row, 3]
        tested |= answers[row, 4]
    while live != 0:
        # Start with the last interval, because most colliding motions of a planner collide near the end.
        k = highest_bit(live)
        if tally[STEPS_LEFT] < 0:
            return Found(UNFINISHED, times[k], near.pair), waiting_count
        live &= ~(1 << k)
        n = N[at + k], N[at + LANES + k], N[at + 2 * LANES + k]
        keep, least = _kept(near, times[k], times[k + 1])
        _count(tally, SEARCHES, 1)
        proven, n, undecided = _proven(motion, near, swept, k, k + 1, least if near.stray > 0.0 else keep, keep, n)
        if proven:
            if live != 0:
                live &= _open_parts(motion, near, swept.links, times, n, False)
            continue
        if near.stray > 0.0 and undecided:
            near = _with_errors(motion, e)
            left = _open_parts(motion, near, swept.links, times, n, True)
            live &= left
            if (left >> k) & 1 == 0:
                continue
            for end in range(k, k + 2):
                if gaps[end] > _margin_at(near, times[end]) + (near.slack - near.stray):
                    tested |= 1 << end
        for end in range(k + 1, k - 1, -1):
            found, tested = _test(motion, near, swept, end, n, found, tested, tally)
            if _hit(found):
                return found, waiting_count
            if row >= 0 and end == k + 1:
                answers[row, 4] |= 1 << end
                is_first = (answers[row, 3] >> INTERVALS) == 0
                answers[row, 3] |= _settled_by_triangles(motion, near, k, is_first, tally)
                live &= ~answers[row, 3]
                if (answers[row, 3] >> k) & 1 != 0:
                    break
        if row >= 0 and (answers[row, 3] >> k) & 1 != 0:
            continue
        if row >= 0:
            answers[row, 4] |= 1 << k
        waiting[waiting_count, 0], waiting[waiting_count, 1], waiting[waiting_count, 2] = e, k, undecided
        normals[waiting_count, 0], normals[waiting_count, 1], normals[waiting_count, 2] = n
        waiting_count += 1
    return found, waiting_count


@inline
def _listed_pair(motion, e):
    """Read the piece pair in row e of the list."""
    listed, ways, at = _listed_of(motion), _listed_ways_of(motion), e * LISTED_WAYS
    pair = listed[e, 0]
    margin, rise = _margin(motion, pair)
    return Near(
        pair, listed[e, 1], listed[e, 2], ways[at], ways[at + 1], margin, rise, ways[at + 2], ways[at + 3],
        ways[at + 4], ways[at + 5], ways[at + 6],
    )  # fmt: skip


@inline
def _with_errors(motion, e):
    """Read a listed pair; compute its `lever`, `wave` and `rest` when they are first needed."""
    if motion.strays and _listed_ways_of(motion)[e * LISTED_WAYS + 4] == 0.0:
        _write_errors(motion, e)
    return _listed_pair(motion, e)


@njit()
def _settle_listed(motion, count, found, tally):
    """Settle the piece pairs of the list."""
    waiting = 0
    for e in range(count):
        found, waiting = _search(motion, e, found, waiting, tally)
        if _hit(found):
            return found
        if waiting > WAITING - LANES:
            found, waiting = _halve_waiting(motion, waiting, found, tally), 0
            if _hit(found):
                return found
    return _halve_waiting(motion, waiting, found, tally)


@apart
def _write_errors(motion, e):
    """Write a listed pair's `lever`, `wave` and `rest`."""
    problem, tables, listed = problem_of(motion.problem), motion_tables_of(motion.tables), _listed_of(motion)
    ways, at = _listed_ways_of(motion), e * LISTED_WAYS + 4
    one, other = problem.pairs[listed[e, 0], 0], problem.pairs[listed[e, 0], 1]
    link, fixed = problem.link[one], problem.link[other] if other < motion.counts.moving else -1
    seen, astray = _ways(motion, False, one, link, fixed), _ways(motion, True, one, link, fixed)
    lever = longest_lever(tables, seen, astray)
    far = lever + pieces_of(motion.pack).hot[listed[e, 1], OUTER_RADIUS]
    ways[at] = lever
    ways[at + 1] = error_of_strays(seen, astray, far, 1.0)
    ways[at + 2] = error_of_strays(seen, astray, far, 0.0) + astray.bend


@inline
def _margin_in_block(motion, pair):
    """Largest distance that two bodies must keep in the block."""
    times, (margin, rise) = _times_of(motion), _margin(motion, pair)
    return margin + max(rise * times[0], rise * times[INTERVALS])


@apart
def _begin_tree(motion, i, other):
    """Begin the walk through a body's tree near piece i, in the body's frame; return the height of the stack."""
    pieces, problem, moving, scratch = (
        pieces_of(motion.pack), problem_of(motion.problem), motion.counts.moving, _scratch_of(motion),
    )  # fmt: skip
    if other >= moving:
        see_piece_standing(problem, i, other - moving, _swept_of(motion), scratch)
    write_box(scratch, 0, reach_of(pieces, other), _box_of(motion))
    _tree_stack_of(motion)[0] = pieces.roots[other]
    return 1


@apart
def _open_group(motion, keep, height):
    """Replace the group on top of the stack with its boxes that are near; return the height of the stack."""
    stack = _tree_stack_of(motion)
    return open_group(pieces_of(motion.pack), stack[height], _box_of(motion), keep * WIDER, stack, height)


@njit()
def _list_pair(motion, pair, live, bend, speed, slack, stray, found, count, tally):
    """List the pieces of two bodies that may be near each other in the intervals `live`.

    Returns
    -------
    found : Found
    count : int
        Number of listed piece pairs; whenever the list is full, it is settled.
    """
    pieces, problem, tables = pieces_of(motion.pack), problem_of(motion.problem), motion_tables_of(motion.tables)
    swept, scratch, times = _swept_of(motion), _scratch_of(motion), _times_of(motion)
    listed, ways, answers = _listed_of(motion), _listed_ways_of(motion), _answers_of(motion)
    one, other, margin = problem.pairs[pair, 0], problem.pairs[pair, 1], _margin_in_block(motion, pair)
    start, moving, hot = pieces.piece_start, motion.counts.moving, pieces.hot
    width = times[1] - times[0]
    keep = margin + slack + bend * width * width / 8.0
    off, rise = _off_together(motion, pair)
    nearer = load(times, 0) * rise + off
    if swept.done[one] & PLACED_PIECES == 0:
        _place_pieces(motion, one)
        tally[STEPS_LEFT] -= start[one + 1] - start[one]
    stack = _tree_stack_of(motion)
    for i in range(start[one], start[one + 1]):
        rows, first = swept.pieces, i * PIECE
        if other < moving:
            see_piece(problem, i, other, swept, scratch)
            rows, first = scratch, 0
        following, height = start[other], 0
        if pieces.roots[other] >= 0:
            following, height = start[other + 1], _begin_tree(motion, i, other)
        while height > 0 or following < start[other + 1]:
            tally[STEPS_LEFT] -= 1
            if tally[STEPS_LEFT] < 0:
                return Found(UNFINISHED, times[0], pair), count
            if height == 0:
                j, following = following, following + 1
            else:
                height -= 1
                if stack[height] >= 0:
                    height = _open_group(motion, keep, height)
                    continue
                j = ~stack[height]
            at = count * LISTED_WAYS
            to = at + _NORMALS
            table, row = (hot, j) if other < moving else (tables.standing_rows, j - start[moving])
            left = near_piece(rows, first, hot[i, OUTER_RADIUS], table, row, keep, nearer, live, ways, to)
            if left == 0:
                continue
            listed[count, 0], listed[count, 1], listed[count, 2], listed[count, 3] = pair, i, j, left
            listed[count, 4] = 0
            if swept.done[one] & PLACED == 0:
                _place_body(motion, one)
            if other < moving and swept.done[other] & PLACED == 0:
                _place_body(motion, other)
            ways[at], ways[at + 1], ways[at + 2], ways[at + 3] = bend, speed, slack, stray
            ways[at + 4] = ways[at + 5] = ways[at + 6] = 0.0
            nearest, deepest, end = DEEP, -1, 0
            for k in range(INTERVALS):
                for last in range(2):
                    share = ways[to + (3 + last) * LANES + k]
                    if (left >> k) & 1 != 0 and share < nearest:
                        nearest, deepest, end = share, k, last
            if deepest >= 0:
                n = ways[to + deepest], ways[to + LANES + deepest], ways[to + 2 * LANES + deepest]
                near = _listed_pair(motion, count)
                row = _row_of_answers(motion, near)
                if row < 0 or answers[row, 4] == 0:  # Among parts of the same surfaces, only the first pair is tested.
                    found, listed[count, 4] = _test(motion, near, swept, deepest + end, n, found, 0, tally)
                    if _hit(found):
                        return found, count
                    if row >= 0:
                        answers[row, 4] = listed[count, 4]
            count += 1
            if count == LISTED:
                found, count = _settle_listed(motion, count, found, tally), 0
                if _hit(found):
                    return found, count
    return found, count


@njit()
def _measure(motion, course, width):
    """Write rates and ways on the course, or on a part that is `width` times the whole course.

    Returns
    -------
    most : float
        Largest second derivative of points, relative to the world.
    travel, angles, places
        Documented in `rates_of`.
    """
    problem, tables, rates = problem_of(motion.problem), motion_tables_of(motion.tables), _rates_of(motion)
    ways, most = _ways_of(motion), 0.0
    travel, angles, places = rates_of(problem.tree, course, width, rates)
    for body in range(motion.counts.moving):
        seen = ways_between(tables, rates, body, problem.link[body], -1)
        ways[body, 0], ways[body, 1] = seen.bend, seen.speed
        most = max(most, seen.bend)
    return most, travel, angles, places


@njit()
def _find_near_pairs(motion, widest):
    """Bound all moving bodies in a block, and find the pairs with static bodies that may be near each other."""
    tables, swept, ways, near_pairs = (
        motion_tables_of(motion.tables), _swept_of(motion), _ways_of(motion), _near_pairs_of(motion),
    )  # fmt: skip
    times, most, rise = _times_of(motion), _most_growth_of(motion)[0], _most_growth_of(motion)[1]
    grown = (1.0 + motion.skew) * (most + max(rise * times[0], rise * times[INTERVALS]))
    for body in range(motion.counts.moving):
        if swept.done[body] == 0:
            _sweep(motion, body)
        keep = (1.0 + motion.skew) * motion.clear + motion.rounding + ways[body, 2]
        keep += ways[body, 0] * widest * widest / 8.0 + grown
        for g in range(tables.group_start[body], tables.group_start[body + 1]):
            live = near_group(tables.groups, g, body, keep, motion.skew, CLEAR_ROUNDINGS, swept)
            for lane in range(LANES):
                near_pairs[tables.group_pairs[g * LANES + lane]] = (live >> lane) & 1


@inline
def _stray(motion, body, link, fixed):
    """How far a body's points may stray relative to a link: V(δ), with the error of turned lengths."""
    return (1.0 + motion.skew) * _ways(motion, True, body, link, fixed).speed


@njit()
def _settle_block(motion, low, high, found, tally):
    """Settle the seven intervals between two times."""
    swept = _swept_of(motion)
    widest = _place_between(motion, low, high, _times_of(motion), swept.links)
    _count(tally, POSES, LANES)
    for body in range(motion.counts.moving):
        swept.done[body] = 0
    found = _settle_pairs(motion, low, widest, found, tally)
    if found.verdict == MAY_BE_HIT:
        # The motion is not FREE. From here on, all bodies are assumed to be exactly at their given poses, and the only
        # remaining question is whether they collide.
        _growth_of(motion)[:] = 0.0
        _most_growth_of(motion)[:] = 0.0
        found = _settle_pairs(motion, low, widest, Found(AMBIGUOUS, found.t, found.pair), tally)
    return found


@apart
def _settle_pairs(motion, low, widest, found, tally):
    """Settle all pairs in a block that begins at the time `low`, and whose links are placed."""
    problem, tables, swept, moving = (
        problem_of(motion.problem), motion_tables_of(motion.tables), _swept_of(motion), motion.counts.moving,
    )  # fmt: skip
    ways, scratch, near_pairs, order = _ways_of(motion), _scratch_of(motion), _near_pairs_of(motion), _order_of(motion)
    tally[STEPS_LEFT] -= moving + len(tables.group_pairs) // LANES
    for row in range(ANSWERS):
        _answers_of(motion)[row, 0] = -1
    count = 0
    for number in range(len(order)):
        pair = order[number]
        if number < FIRST_PAIRS:
            for end in range(2):
                body = problem.pairs[pair, end]
                if body < moving and swept.done[body] == 0:
                    _sweep(motion, body)
        elif number == FIRST_PAIRS:
            _find_near_pairs(motion, widest)
        if number >= FIRST_PAIRS and near_pairs[pair] == 0:
            continue
        tally[STEPS_LEFT] -= 1
        if tally[STEPS_LEFT] < 0:
            return Found(UNFINISHED, low, pair)
        one, other, margin = problem.pairs[pair, 0], problem.pairs[pair, 1], _margin_in_block(motion, pair)
        slack, stray = motion.rounding + motion.skew * margin, ways[one, 2]
        if other >= moving:
            k = other - moving
            bend, speed = ways[one, 0], ways[one, 1]
            slack += stray
            slack += CLEAR_ROUNDINGS * position_error(tables.sizes[k], UNIT_ROUNDOFF)
            live = near_standing(problem, one, k, margin + slack + bend * widest * widest / 8.0, swept)
        else:
            # First compare the paths of the two bodies in the world frame. This comparison is cheap and leaves few
            # pairs.
            bend, stray = ways[one, 0] + ways[other, 0], stray + ways[other, 2]
            live = near_in_world(problem, one, other, margin + slack + stray + bend * widest * widest / 8.0, swept)
            if live == 0:
                continue
            if motion.strays:
                # Both values bound the distance by which strays can bring the two bodies closer together.
                stray = min(stray, _stray(motion, one, problem.link[one], problem.link[other]))
                slack += stray
            seen = _ways(motion, False, one, problem.link[one], problem.link[other])
            bend, speed = seen.bend, seen.speed
            live &= near_moving(problem, one, other, margin + slack + bend * widest * widest / 8.0, swept, scratch)
        if speed == 0.0 and _margin(motion, pair)[1] == 0.0:
            live &= 1  # The two bodies do not move relative to each other, so one interval is enough.
        if live != 0:
            found, count = _list_pair(motion, pair, live, bend, speed, slack, stray, found, count, tally)
            if _hit(found):
                return found
    return _settle_listed(motion, count, found, tally)


@njit()
def _certify(motion, tally):
    """Settle one motion, whose course has been written."""
    if tally[STEPS_LEFT] < 0:
        return Found(AMBIGUOUS, 0.0, -1)
    problem, tables, course = problem_of(motion.problem), motion_tables_of(motion.tables), _course_of(motion)
    most, travel, angles, places = _measure(motion, course, 1.0)
    strays, slides, turns = motion.strays, 0.0, 0.0
    if strays:
        slides, turns = write_strays(problem.tree, _off_of(motion), _rates_of(motion), _strays_of(motion))
    off, length, turned = uncertainty(tables, travel + slides, angles, places)
    rounding = 8.0 * off + 4.0 * tables.chain[2] * length
    rounding += CLEAR_ROUNDINGS * position_error(4.0 * length, UNIT_ROUNDOFF)
    skew = 2.0 * turned + 2.0 * tables.chain[2]
    # This bound covers the strays of all joints together, and holds for any two bodies.
    astray = 2.0 * (1.0 + skew) * (turns * length + slides)
    if astray < ROUNDED_STRAY * motion.tolerance:
        rounding, strays = rounding + astray, False
    motion = Motion(
        motion.pack, motion.problem, motion.tables, motion.tolerance, rounding, skew, strays, motion.clear,
        motion.as_given, motion.points, motion.counts, motion.work,
    )  # fmt: skip
    if not rounding < np.inf:
        return Found(TOO_LONG, np.nan, -1)  # There is no bound: an orientation may turn arbitrarily fast.
    for body in range(motion.counts.moving):
        link = problem.link[body]
        _ways_of(motion)[body, 2] = _stray(motion, body, link, -1) if motion.strays else 0.0
    blocks = 1
    while not most / (8.0 * (INTERVALS * blocks) ** 2) <= FIRST_OFF:
        blocks *= 2
        if blocks > MOST_BLOCKS:
            return Found(TOO_LONG, np.nan, -1)
    answer = Found(FREE, np.nan, -1)
    for number in range(blocks):
        # Take the blocks in the order of their numbers with reversed bits: block 0, then the middle one, and so on.
        block, bit, rest = 0, blocks // 2, number
        while rest != 0:
            block += bit * (rest & 1)
            rest >>= 1
            bit //= 2
        low, high = block / blocks, (block + 1) / blocks
        if tally[STEPS_LEFT] < 0:
            answer = Found(UNFINISHED, low, -1)
            break
        if blocks > 1 and motion.points > 2:
            write_part(course, low, high, _scratch_points_of(motion), _part_of(motion))
            _measure(motion, _part_of(motion), high - low)
        answer = _settle_block(motion, low, high, answer, tally)
        if _hit(answer):
            break
    return Found(AMBIGUOUS, answer.t, answer.pair) if answer.verdict == UNFINISHED else answer


@inline
def _motion(pack, problem_handle, tables_handle, tolerance, strays, clear, as_given, points, dof, memory):
    """Make a motion in prepared memory; its course has yet to be written."""
    counts = counts_of(pieces_of(pack), problem_of(problem_handle), dof)
    return Motion(
        pack, problem_handle, tables_handle, tolerance, 0.0, 0.0, strays, clear, as_given, points, counts, memory
    )


@njit()
def make_ready(pack, problem_handle, tables_handle, dof, memory):
    """Write the data that all motions share to the memory."""
    motion = _motion(pack, problem_handle, tables_handle, 0.0, False, 0.0, False, 2, dof, memory)
    order, first = _order_of(motion), motion_tables_of(tables_handle).order
    for k in range(len(order)):
        order[k] = first[k]
    same, ends, near_pairs = _relative_of(motion), _ends_of(motion), _near_pairs_of(motion)
    for pair in range(len(near_pairs)):
        near_pairs[pair] = 1
    _growth_of(motion)[:] = 0.0
    _most_growth_of(motion)[:] = 0.0
    same[:] = 0.0
    ends[:] = 0.0
    for c in range(4):
        same[0, c, c] = 1.0


@njit()
def _write_growth(motion, off):
    """Write how far points of bodies may be off on a motion, from the argument `off` of `certify_motions`."""
    growth, most, start, end, any_off = _growth_of(motion), _most_growth_of(motion), 0.0, 0.0, False
    for at in range(motion.counts.dof, len(off), 3):
        body = int(off[at])
        if body >= 0:
            growth[body, 0], growth[body, 1] = off[at + 1], off[at + 2] - off[at + 1]
            any_off |= max(off[at + 1], off[at + 2]) > 0.0
        if body >= motion.counts.moving:
            start, end = max(start, off[at + 1]), max(end, off[at + 2])
    most[0], most[1], most[2] = start, end - start, any_off


@njit()
def certify_motions(
    start,
    stop,
    courses,
    off,
    clear,
    tolerance,
    pack,
    problem_handle,
    tables_handle,
    out,
    t_out,
    pair_out,
    tallies,
    memory,
):
    """Settle the motions start .. stop at every one of their configurations.

    Parameters
    ----------
    courses : ndarray, shape (N, degree + 1, dof)
        See `motion_path`.
    off : ndarray, shape (N, dof + 3 growing) or (0, dof)
        Allowed deviation of each value from the course at the same fraction: FREE holds for all such configurations,
        and COLLIDING for a configuration on the course itself. An array without rows allows no deviation. Three more
        numbers follow for each body whose points may be off: its number, and how far they may be off [m] at the start
        and at the end; in between, this distance changes linearly. A negative number stands for no body.
    clear : ndarray, shape (N,) or (0,)
        Distances [m] that all pairs must keep on a motion in addition to their margins; an array without rows adds
        none.
    tolerance : float
        Tolerance in metres: a motion on which bodies come within the margin plus the tolerance may be AMBIGUOUS.
    pack : int
        Handle of the packed bodies, see `configurations.check_configurations`.
    problem_handle, tables_handle : int
        Handles of the problem and the tables, see `pack.problem_of` and `pack.motion_tables_of`.
    out : ndarray of int8, shape (N,)
        Receives FREE, COLLIDING, AMBIGUOUS, TOO_LONG or BY_CARE. On entry, 0 means that COLLIDING refers to margins
        enlarged by how far points may be off, and 1 that it refers to the margins alone. With 1, a motion on which a
        body may be hit is AMBIGUOUS where this is first found, and the search continues for a collision.
    t_out : ndarray, shape (N,)
        Receives the fraction at which a motion is colliding or ambiguous; NaN for the other motions.
    pair_out : ndarray of int64, shape (N,)
        Receives the number of the colliding or ambiguous pair; -1 for the other motions.
    tallies : ndarray of int64, shape (N, 3)
        Receives the numbers of placed configurations, of searches, and of steps. On entry, the last entry is the number
        of steps after which a motion is given up as AMBIGUOUS; -1 stands for the number that the previous motion left.
    memory : int
        Address of `motion_memory()` scratch bytes; only one thread may use them at a time.
    """
    _, points, dof = courses.shape
    make_ready(pack, problem_handle, tables_handle, dof, memory)
    left = NO_LIMIT
    for k in range(start, stop):
        more = clear[k] if len(clear) > 0 else 0.0
        motion = _motion(
            pack, problem_handle, tables_handle, tolerance, len(off) > 0, more, out[k] != 0, points, dof, memory
        )  # fmt: skip
        course, strays = _course_of(motion), _off_of(motion)
        for c in range(dof):
            for point in range(points):
                course[point, c] = courses[k, point, c]
            strays[c] = off[k, c] if motion.strays else 0.0
        if motion.strays and off.shape[1] > dof:
            _write_growth(motion, off[k])
        most = tallies[k, STEPS_LEFT] if tallies[k, STEPS_LEFT] >= 0 else left
        tallies[k, POSES], tallies[k, SEARCHES], tallies[k, STEPS_LEFT] = 0, 0, most
        answer = _certify(motion, tallies[k])
        left = tallies[k, STEPS_LEFT]
        tallies[k, STEPS_LEFT] = most - left
        out[k], t_out[k], pair_out[k] = answer.verdict, answer.t, answer.pair


@njit()
def certified(pack, problem_handle, tables_handle, tolerance, error, ends, tally, memory):
    """Return whether one motion is FREE, see `certify_motions`, with prepared memory.

    FREE covers all configurations whose values deviate by at most the numbers at the address `error`, shape (dof,),
    unless the address is 0. The placed configurations and searches are added to `tally`, shape (3,); its last entry,
    the number of remaining steps, is reduced. A pair that is not free is moved forward, so that pairs that collide most
    often come first.
    """
    dof = ends.shape[1]
    motion = _motion(pack, problem_handle, tables_handle, tolerance, error != 0, 0.0, False, 2, dof, memory)
    course = _course_of(motion)
    for c in range(dof):
        course[0, c], course[1, c] = ends[0, c], ends[1, c]
    if motion.strays:
        allowed, off = floats_at(error, (dof,)), _off_of(motion)
        for c in range(dof):  # The sum is rounded as in `loewner.robots.proofs.proofs.deviations`.
            off[c] = allowed[c] + 2.0 * VALUE_ROUNDINGS * max(abs(ends[0, c]), abs(ends[1, c]))
    answer = _certify(motion, tally)
    if answer.pair >= 0:
        order = _order_of(motion)
        k = 0
        while order[k] != answer.pair:
            k += 1
        for at in range(k, k // 2, -1):
            order[at] = order[at - 1]
        order[k // 2] = answer.pair
    return answer.verdict == FREE


@njit()
def free_motions(
    prepared, start, stop, courses, error, tolerance, pack, problem_handle, tables_handle, tallies, out, memory
):
    """Find which of the straight motions start .. stop are FREE, as `certified` does, for validators of motions.

    Parameters
    ----------
    prepared : int
        0 in the first call with a memory. The memory keeps the order of the pairs from call to call.
    courses, tolerance, pack, problem_handle, tables_handle, memory
        Documented in `certify_motions`; courses have two points.
    error : int
        Documented in `certified`.
    tallies : ndarray of int64, shape (N, 3)
        Documented in `certify_motions`, with a number of steps for each motion.
    out : ndarray of int8, shape (N,)
        Receives 1 for motions that are free, and 0 for the other motions.
    """
    if prepared == 0:
        make_ready(pack, problem_handle, tables_handle, courses.shape[2], memory)
    for k in range(start, stop):
        tallies[k, POSES], tallies[k, SEARCHES], most = 0, 0, tallies[k, STEPS_LEFT]
        out[k] = certified(pack, problem_handle, tables_handle, tolerance, error, courses[k], tallies[k], memory)
        tallies[k, STEPS_LEFT] = most - tallies[k, STEPS_LEFT]
