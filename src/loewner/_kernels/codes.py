"""Codes that kernels and Python share: modes of queries, and outcomes."""

FREE, COLLIDING, AMBIGUOUS = 0, 1, 2

# Codes that a kernel may return instead of a verdict. INEXACT: only exact integer arithmetic can decide (see
# `fallback`). LEFT: a GPU thread leaves the pair to the CPU; among the piece pairs of two bodies, LEFT outranks
# AMBIGUOUS (see `threads.pairs`). TOO_LONG: the proof of a motion would take too many intervals. BY_CARE: the motion
# collides if `collide` confirms this. UNFINISHED: the steps ran out before the proof ended. MAY_BE_HIT: a body may be
# hit somewhere within its bounds, but no collision was found at its given pose.
INEXACT, LEFT, TOO_LONG, BY_CARE, UNFINISHED, MAY_BE_HIT = 3, 4, 5, 6, 7, 8

# A limit on steps that no proof ever reaches, for proofs without a limit.
NO_LIMIT = 2**62

# Largest number of intervals into which a motion is cut before any interval is halved.
MOST_INTERVALS = 7 * 2**16

# Largest number of rows of a course. Eight rows describe polynomials of degree 7, which is more than controllers and
# planners use.
MOST_POINTS = 8

# Outcomes of a search for the distance of two pieces: no result (UNSETTLED), pieces proven apart, pieces proven to
# touch, final distance, overlapping cores, final depth.
UNSETTLED, APART, TOUCHING, NEAREST, OVERLAPPING, DEPTH_FOUND = 0, 1, 2, 3, 4, 5

CERTIFY, EXACT = 0, 1

# Tiers: the test that settled a pair of pieces, or OPEN if no test did. The test of BY_PLANE compares the support
# planes of the pieces that are perpendicular to the contact normal of their ellipsoids.
BY_SPHERE, BY_OUTER, BY_INNER, BY_PLANE, BY_SEARCH, OPEN = 0, 1, 2, 3, 4, 5
TIERS = 6
UNSURE = TIERS  # UNSURE is not a tier: `certificate.certify` returns it if a better parameter s might settle the pair.

# Faults of a pose.
RIGID, NOT_FINITE, LAST_ROW, NOT_ORTHONORMAL, REFLECTION = 0, 1, 2, 3, 4

# Methods for finding the near points of two ellipsoids, and their possible outcomes.
RIMON_BOYD, LIN_HAN, CENTER_LINE = 0, 1, 2
SEPARATE, OVERLAP, UNCONVERGED = 0, 1, 2

# Code that replaces a winding number if no ray determines it.
UNCOUNTED = -(2**62)

# Faults of a fit; 0 means success.
FLAT, STALLED, UNBOUNDED = 1, 2, 3

# Faults of a hull: its simplices do not form a closed surface, a face does not pass through its own vertices, or the
# simplices cannot be oriented consistently.
NOT_CLOSED, FACE_OFF, INSIDE_OUT = 11, 12, 13

# Outcomes of a search for a path: the trees met, all iterations were used, or the memory for the trees is full.
MET, SPENT, FULL = 0, 1, 2

# Outcomes of following a line: the robot followed it to its end; the line requires half a turn; it is too long; the
# tolerances prevent the next step; or the axis to be kept prevents it.
FOLLOWED, HALF_TURN, TOO_FAR, STOPPED, TILTED = 0, 1, 2, 3, 4

# Codes of the elementary functions, for calls from Python and C.
SINE_OF, COSINE_OF, ARC_TANGENT, ARC_COSINE, ARC_SINE, EXPONENTIAL, LOGARITHM, CUBE_ROOT = 0, 1, 2, 3, 4, 5, 6, 7
