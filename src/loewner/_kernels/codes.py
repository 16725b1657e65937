"""Codes shared by kernels and Python: modes of queries, and outcomes."""

FREE, COLLIDING, AMBIGUOUS = 0, 1, 2

# Codes in place of a verdict. Whole numbers must decide (`fallback`); a GPU thread leaves the pair to the CPU (above
# AMBIGUOUS, see `threads.pairs`); a motion takes too many intervals, collides if `collide` confirms it, or has no steps
# left; a body that is not at its given pose may be hit.
INEXACT, LEFT, TOO_LONG, BY_CARE, UNFINISHED, MAY_BE_HIT = 3, 4, 5, 6, 7, 8

# Number of steps of a proof that has no limit.
NO_LIMIT = 2**62

# Largest number of intervals into which a motion is cut before any is halved.
MOST_INTERVALS = 7 * 2**16

# Rows of the longest course: polynomials of degree 7, which is more than controllers and planners use.
MOST_POINTS = 8

# Outcome of a search on two pieces: no result; proven apart or touching; the distance is final; the cores overlap; the
# depth is final.
UNSETTLED, APART, TOUCHING, NEAREST, OVERLAPPING, DEPTH_FOUND = 0, 1, 2, 3, 4, 5

CERTIFY, EXACT = 0, 1

# The test that settled a piece pair; BY_PLANE: the support planes of the pieces perpendicular to the contact normal of
# their ellipsoids.
BY_SPHERE, BY_OUTER, BY_INNER, BY_PLANE, BY_SEARCH, OPEN = 0, 1, 2, 3, 4, 5
TIERS = 6
UNSURE = TIERS  # No tier: `certificate.certify` returns it if a better s may settle the pair

# Faults of a pose.
RIGID, NOT_FINITE, LAST_ROW, NOT_ORTHONORMAL, REFLECTION = 0, 1, 2, 3, 4

# Near points of two ellipsoids: methods, and outcomes.
RIMON_BOYD, LIN_HAN, CENTER_LINE = 0, 1, 2
SEPARATE, OVERLAP, UNCONVERGED = 0, 1, 2

# Code for a winding number that no ray determines.
UNCOUNTED = -(2**62)

# Outcome of a fit (0 is success), ...
FLAT, STALLED, UNBOUNDED = 1, 2, 3

# ... and of a hull: its simplices do not close up, a face does not pass through its own vertices, or the simplices
# cannot be oriented.
NOT_CLOSED, FACE_OFF, INSIDE_OUT = 11, 12, 13

# Outcome of a search for a path: the trees met, all iterations were used, or the memory for trees is full.
MET, SPENT, FULL = 0, 1, 2

# Outcome of following a line: it was followed to its end; it turns by half a turn or is too long; or it cannot be
# continued because of the tolerances or because of a kept axis.
FOLLOWED, HALF_TURN, TOO_FAR, STOPPED, TILTED = 0, 1, 2, 3, 4

# Elementary functions, for Python and C.
SINE_OF, COSINE_OF, ARC_TANGENT, ARC_COSINE, ARC_SINE, EXPONENTIAL, LOGARITHM, CUBE_ROOT = 0, 1, 2, 3, 4, 5, 6, 7
