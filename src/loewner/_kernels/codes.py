"""Codes that kernels and Python share: what is asked, and how it came out."""

FREE, COLLIDING, AMBIGUOUS = 0, 1, 2

# No verdicts, in place of one: whole numbers have to decide (`fallback`); a thread of a GPU leaves the pair to the CPU
# (above AMBIGUOUS, see `threads.pairs`); a motion takes too many intervals, or collides if `collide` confirms it.
INEXACT, LEFT, TOO_LONG, BY_CARE = 3, 4, 5, 6

# Intervals that a motion is cut into at most before any is halved.
MOST_INTERVALS = 7 * 2**16

# Rows of the longest course: polynomials of degree 7, which is more than controllers and planners use.
MOST_POINTS = 8

# How a search on two pieces ended: without a result; they are proven apart or touching; the distance is final; their
# cores overlap; the depth is final.
UNSETTLED, APART, TOUCHING, NEAREST, OVERLAPPING, DEPTH_FOUND = 0, 1, 2, 3, 4, 5

CERTIFY, EXACT = 0, 1

# Who settled a piece pair; BY_PLANE: the support planes of the pieces square to the contact normal of their ellipsoids.
BY_SPHERE, BY_OUTER, BY_INNER, BY_PLANE, BY_SEARCH, OPEN = 0, 1, 2, 3, 4, 5
TIERS = 6
UNSURE = TIERS  # no tier: what `certificate.certify` says where a better s may settle a pair

# What is wrong with a pose.
RIGID, NOT_FINITE, LAST_ROW, NOT_ORTHONORMAL, REFLECTION = 0, 1, 2, 3, 4

# Near points of two ellipsoids: methods, and how a method ended.
RIMON_BOYD, LIN_HAN, CENTER_LINE = 0, 1, 2
SEPARATE, OVERLAP, UNCONVERGED = 0, 1, 2

# What stands for a winding number that no ray tells.
UNCOUNTED = -(2**62)

# How a fit ended (0 is success), ...
FLAT, STALLED, UNBOUNDED = 1, 2, 3

# ... and how a hull did: its simplices do not close up, a face does not pass through its own vertices, or the simplices
# cannot be oriented.
NOT_CLOSED, FACE_OFF, INSIDE_OUT = 11, 12, 13

# How a search for a path ended: the trees met, all iterations are done, or the memory for trees is full.
MET, SPENT, FULL = 0, 1, 2
