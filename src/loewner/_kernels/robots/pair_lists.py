"""For Python and C: list the pairs of bodies to check, and make the tables that kernels take with bodies and poses.

`list_pairs` applies the rules of a scene. `lay_out` divides memory into the arrays of `records.Problem` and
`records.MotionTables`. `lay_out` also writes the entries that do not depend on the poses of static bodies or the values
of joints. These entries are paths and lengths of links, balls about moving bodies, groups of pairs, and the order in
which proofs of motions take the pairs.
"""

import math

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import (
    BOUNDS,
    CACHE_LINE,
    COSINE,
    FIXED,
    HOT,
    PLANAR,
    REACH,
    REVOLUTE,
    ROTATION,
    SINE,
    TRANSLATION,
)
from loewner._kernels.pieces.pack import motion_tables_of, pieces_of, problem_of
from loewner._kernels.records import ENTRIES, MOTION_ROWS, MOTIONS, PROBLEM_ROWS, TABLE
from loewner._kernels.robots.standing import measure_moving
from loewner._kernels.simd.memory import held, integers_at
from loewner._kernels.simd.vectors import LANES, rounded_product
from loewner._kernels.tolerances import CHAIN_STRETCH

BALL, STANDING, STANDING_ROWS, STANDING_POSES = (
    PROBLEM_ROWS[name] for name in ("ball", "standing", "standing_rows", "standing_poses")
)
PATH_START, PATH_LINK, REACHES, EXACT_ROWS, SIZES, ORDER, GROUP_START, GROUP_PAIRS, GROUPS, CHAIN = MOTION_ROWS.values()

# Cosines of the multiples of an eighth of a turn. At these angles, a joint's rotation matrix R is tested: the entries
# of RᵀR - 1 are sums of a constant and of waves in the angle and in twice the angle, so the norm of RᵀR - 1 is always
# less than twice the largest of the eight samples.
_DIAGONAL = math.sqrt(0.5)
COSINES = 1.0, _DIAGONAL, 0.0, -_DIAGONAL, -1.0, -_DIAGONAL, 0.0, _DIAGONAL


# -- pairs -------------------------------------------------------------------------------------


@njit()
def list_pairs(parent, kind, link, marks, own, least, rules, rule_margins, pairs, margins):
    """List the pairs of bodies that can meet but may not touch, and their margins, see `Scene.margin_of`.

    Parameters
    ----------
    parent, kind : ndarray of int64
        See `records.Tree`: bodies on links that are rigidly joined cannot meet.
    link : ndarray of int64, shape (moving bodies,)
        Links of the moving bodies, which come first; pairs without a moving body are not listed.
    marks : ndarray of int64, shape (bodies, 3)
        Whether a body belongs to the robot, and whether each of its two margins in `own` overrides the margins in
        `least`.
    own : ndarray, shape (bodies, 2)
        Margins of a body against any other body, and against bodies of the robot.
    least : ndarray, shape (2,)
        Margins of all pairs, and of pairs within the robot.
    rules : ndarray of int64, shape (rules, 4)
        Two bodies, -1 for an absent body; 1 if they may touch, 0 if they may not, -1 if the rule concerns only their
        margin; and whether this margin overrides all other margins. Later rules override earlier ones.
    rule_margins : ndarray, shape (rules,)
        Margins of the pairs with rules; negative if a rule has no margin.
    pairs, margins : ndarray, shapes (most, 2) and (most,)
        Receive the pairs, in ascending order, and have room for all pairs with a moving body.

    Returns
    -------
    int
        Number of pairs.
    """
    moving, bodies, count, kept = len(link), len(own), 0, 0
    for a in range(moving):
        for b in range(a + 1, bodies):
            pairs[count, 0], pairs[count, 1], margins[count] = a, b, _margin(marks, own, least, a, b)
            count += 1
    for k in range(len(rules)):
        a, b = min(rules[k, 0], rules[k, 1]), max(rules[k, 0], rules[k, 1])
        if a < 0 or a >= moving:
            continue
        at = a * (2 * bodies - a - 1) // 2 + b - a - 1
        if rules[k, 2] >= 0:
            pairs[at, 0] = -1 if rules[k, 2] else a
        if rule_margins[k] >= 0.0:
            margins[at] = rule_margins[k] if rules[k, 3] else max(rule_margins[k], margins[at])
    for k in range(count):
        a, b = pairs[k, 0], pairs[k, 1]
        if a >= 0 and (b >= moving or _rigid_with(parent, kind, link[a]) != _rigid_with(parent, kind, link[b])):
            pairs[kept, 0], pairs[kept, 1], margins[kept] = a, b, margins[k]
            kept += 1
    return kept


@inline
def _rigid_with(parent, kind, link):
    """The first link with which a link is rigidly joined; -1 is the world."""
    return parent[link] if kind[link] == FIXED else link


@inline
def _margin(marks, own, least, a, b):
    """The margin of two bodies without a rule for the pair."""
    margin, lowered = max(own[a, 0], own[b, 0]), marks[a, 1] | marks[b, 1]
    if marks[a, 0]:
        margin, lowered = max(margin, own[b, 1]), lowered | marks[b, 2]
    if marks[b, 0]:
        margin, lowered = max(margin, own[a, 1]), lowered | marks[a, 2]
    return margin if lowered else max(margin, least[marks[a, 0] & marks[b, 0]])


# -- tables ------------------------------------------------------------------------------------


@njit()
def lay_out(pack, handle, lasting, block):
    """Complete the table of a problem, with its arrays in the caller's memory; static bodies are not placed yet.

    Parameters
    ----------
    pack, handle : int
        Handles of the bodies, and of a `records.Problem` with its tree, `link`, `pairs`, `margins` and `order`.
    lasting, block : ndarray
        `lasting` is memory for the arrays that depend on no pose. At the first cache line of `block`, the tables of the
        problem and of its `records.MotionTables` begin, see `standing.place_static`. Without memory, only sizes are
        computed.

    Returns
    -------
    lasting_words, block_words : int
        Sizes of the two memories in words.
    made : int
        Handle of the problem in the block.
    """
    pieces, draft = pieces_of(pack), problem_of(handle)
    tree, pairs, moving, bodies = draft.tree, draft.pairs, len(draft.link), len(pieces.piece_start) - 1
    links, rows = len(tree.parent), pieces.piece_start[bodies] - pieces.piece_start[moving]
    depths, counts = np.empty(links, np.int64), np.zeros(moving, np.int64)
    joints = in_groups = 0
    for k in range(links):
        depths[k] = (depths[tree.parent[k]] if tree.parent[k] >= 0 else 0) + (tree.kind[k] != FIXED)
        joints += depths[k]
    for k in range(len(pairs)):
        if pairs[k, 1] >= moving:
            in_groups += LANES if counts[pairs[k, 0]] % LANES == 0 else 0
            counts[pairs[k, 0]] += 1
    table, start, made = np.empty(TABLE, np.int64), np.int64(lasting.ctypes.data), np.int64(block.ctypes.data)
    made += -made % CACHE_LINE
    for k in range(MOTIONS // 8):
        table[k] = integers_at(handle, (MOTIONS // 8,))[k]
    lasting_words = _divide(table, start, (
        (BALL, moving, 5, 8), (PATH_START, links + 1, 1, 8), (PATH_LINK, joints, 1, 8),
        (ORDER, len(pairs), 1, 8), (GROUP_START, moving + 1, 1, 8), (GROUP_PAIRS, in_groups, 1, 8), (CHAIN, 3, 1, 8),
    ))  # fmt: skip
    block_words = TABLE + CACHE_LINE // 8 + _divide(table, made + 8 * TABLE, (
        (REACHES, bodies, links, 8), (EXACT_ROWS, rows, HOT, 8), (SIZES, bodies - moving, 1, 8),
        (GROUPS, 8 * in_groups, 1, 8), (STANDING, bodies - moving, BOUNDS, 4), (STANDING_ROWS, rows, HOT, 4),
        (STANDING_POSES, bodies - moving, 16, 8),
    ))  # fmt: skip
    if len(block) > 0:
        block[:] = 0.0
        for k in range(TABLE):
            integers_at(made, (TABLE,))[k] = table[k]
        problem, tables = problem_of(made), motion_tables_of(made + MOTIONS)
        problem.standing_poses[:] = np.nan  # NaN differs from every number, so all poses count as changed.
        _write_paths(tree, tables)
        _write_order(depths, problem, tables)
        _write_group_pairs(counts, pairs, tables)
        _write_chain(depths, pieces, problem, tables.chain)
        measure_moving(pack, made, made + MOTIONS)
    held(lasting)
    held(block)
    return lasting_words, block_words, made


@inline
def _divide(table, at, shapes):
    """Write the table rows of arrays that are stored one after another; return the number of words that they take.

    The arrays begin at the address `at`. A shape holds the number of the table row, the array's rows and columns, and
    the bytes of an entry.
    """
    words = 0
    for row, rows, columns, size in shapes:
        table[ENTRIES * row], table[ENTRIES * row + 1], table[ENTRIES * row + 2] = at + 8 * words, rows, columns
        words += rows * columns * size // 8
    return words


@njit()
def _write_paths(tree, tables):
    """List the joints between the world and each link."""
    at = tables.path_start[0] = 0
    for k in range(len(tree.parent)):
        above = tree.parent[k]
        if above >= 0:
            for n in range(tables.path_start[above], tables.path_start[above + 1]):
                tables.path_link[at] = tables.path_link[n]
                at += 1
        if tree.kind[k] != FIXED:
            tables.path_link[at] = k
            at += 1
        tables.path_start[k + 1] = at


@njit()
def _write_order(depths, problem, tables):
    """Sort the pairs, stably, by their bodies' depths: bodies far out on the robot move and collide most."""
    at = 0
    for depth in range(len(depths), -1, -1):
        for k in range(len(problem.pairs)):
            if depths[problem.link[problem.pairs[k, 0]]] == depth:
                tables.order[at] = k
                at += 1


@njit()
def _write_group_pairs(counts, pairs, tables):
    """Put each body's pairs with static bodies in groups of eight; repeats fill the last group."""
    moving, start = len(counts), tables.group_start
    start[0] = 0
    for body in range(moving):
        start[body + 1] = start[body] + (counts[body] + LANES - 1) // LANES
        counts[body] = LANES * start[body]  # From here on, this is the place of the body's next pair.
    for k in range(len(pairs)):
        body = pairs[k, 0]
        if pairs[k, 1] >= moving:
            tables.group_pairs[counts[body]] = k
            counts[body] += 1
    for body in range(moving):
        for at in range(counts[body], LANES * start[body + 1]):
            tables.group_pairs[at] = tables.group_pairs[at - 1]


@njit()
def _write_chain(depths, pieces, problem, chain):
    """Describe the longest chain of links up to the points of a body; no product is fused with a sum."""
    tree, lengths = problem.tree, np.empty(len(depths))
    for k in range(len(lengths)):
        square = 0.0
        for column in range(TRANSLATION, TRANSLATION + 3):
            square += rounded_product(tree.constants[k, column], tree.constants[k, column])
        lengths[k] = np.sqrt(square) + (lengths[tree.parent[k]] if tree.parent[k] >= 0 else 0.0)
    chain[0], chain[1], chain[2] = 1.0, 0.0, 0.0
    for body in range(len(problem.link)):
        far = 0.0
        for piece in range(pieces.piece_start[body], pieces.piece_start[body + 1]):
            far = max(far, pieces.table[piece, REACH])
        chain[0] = max(chain[0], 1.0 + depths[problem.link[body]])
        chain[1] = max(chain[1], (lengths[problem.link[body]] + far) * CHAIN_STRETCH)
    for link in range(len(lengths)):
        chain[2] += 2.0 * _bend(tree, link)


@njit()
def _bend(tree, link):
    """Largest deviation of a link's rotation from orthonormality, at eighths of a turn."""
    turns, worst, R = tree.kind[link] in (REVOLUTE, PLANAR), 0.0, np.empty(9)
    for step in range(8):
        sine, cosine, squares = (COSINES[(step + 6) % 8], COSINES[step], 0.0) if turns else (0.0, 0.0, 0.0)
        for k in range(9):
            R[k] = tree.constants[link, ROTATION + k] + rounded_product(sine, tree.constants[link, SINE + k])
            R[k] += rounded_product(cosine, tree.constants[link, COSINE + k])
        for a in range(3):
            for b in range(3):
                off = rounded_product(R[a], R[b]) + rounded_product(R[3 + a], R[3 + b])
                off = off + rounded_product(R[6 + a], R[6 + b]) - (1.0 if a == b else 0.0)
                squares += rounded_product(off, off)
        worst = max(worst, np.sqrt(squares))
    return worst
