"""Codes that kernels and Python share: modes of queries, and outcomes."""

FREE, COLLIDING, AMBIGUOUS = 0, 1, 2

# Codes in place of a verdict. INEXACT means that exact integers must decide (`fallback`). LEFT means that a GPU thread
# leaves the pair to the CPU; LEFT outranks AMBIGUOUS, see `threads.pairs`. A motion is TOO_LONG if it takes too many
# intervals. BY_CARE means that the motion collides if `collide` confirms this. UNFINISHED means that no steps are left.
# MAY_BE_HIT means that a body may be hit, but not at its given pose.
INEXACT, LEFT, TOO_LONG, BY_CARE, UNFINISHED, MAY_BE_HIT = 3, 4, 5, 6, 7, 8

# A limit on steps that is never reached, for proofs without a limit.
NO_LIMIT = 2**62

# Largest number of intervals into which a motion is cut before any interval is halved.
MOST_INTERVALS = 7 * 2**16

# Largest number of rows of a course. MOST_POINTS allows polynomials of degree 7, which is more than controllers and
# planners use.
MOST_POINTS = 8

# Outcomes of a search on two pieces: no result (UNSETTLED), pieces proven apart, pieces proven to touch, final
# distance, overlapping cores, final depth.
UNSETTLED, APART, TOUCHING, NEAREST, OVERLAPPING, DEPTH_FOUND = 0, 1, 2, 3, 4, 5

CERTIFY, EXACT = 0, 1

# The test that settled a pair of pieces. BY_PLANE compares the support planes of the pieces perpendicular to the
# contact normal of their ellipsoids.
BY_SPHERE, BY_OUTER, BY_INNER, BY_PLANE, BY_SEARCH, OPEN = 0, 1, 2, 3, 4, 5
TIERS = 6
UNSURE = TIERS  # UNSURE is not a tier: `certificate.certify` returns it if a better parameter s may settle the pair.

# Faults of a pose.
RIGID, NOT_FINITE, LAST_ROW, NOT_ORTHONORMAL, REFLECTION = 0, 1, 2, 3, 4

# Methods for finding the near points of two ellipsoids, and their possible outcomes.
RIMON_BOYD, LIN_HAN, CENTER_LINE = 0, 1, 2
SEPARATE, OVERLAP, UNCONVERGED = 0, 1, 2

# Code for a winding number that no ray determines.
UNCOUNTED = -(2**62)

# Faults of a fit; 0 means success.
FLAT, STALLED, UNBOUNDED = 1, 2, 3

# Faults of a hull: its simplices do not close up, a face does not pass through its own vertices, or the simplices
# cannot be oriented.
NOT_CLOSED, FACE_OFF, INSIDE_OUT = 11, 12, 13

# Outcomes of a search for a path: the trees met, all iterations were used, or the memory for the trees is full.
MET, SPENT, FULL = 0, 1, 2

# Outcomes of following a line: the line was followed to its end; it turns by half a turn; it is too long; the
# tolerances prevent the next step; or a kept axis prevents it.
FOLLOWED, HALF_TURN, TOO_FAR, STOPPED, TILTED = 0, 1, 2, 3, 4

# Elementary functions, for Python and C.
SINE_OF, COSINE_OF, ARC_TANGENT, ARC_COSINE, ARC_SINE, EXPONENTIAL, LOGARITHM, CUBE_ROOT = 0, 1, 2, 3, 4, 5, 6, 7
