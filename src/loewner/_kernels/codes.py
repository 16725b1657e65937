"""Codes that kernels and Python share: what is asked, and how it came out."""

FREE, COLLIDING, AMBIGUOUS = 0, 1, 2
INEXACT = 3  # no verdict: what `fallback` says where whole numbers have to tell
LEFT = 3  # no verdict: a thread of a GPU leaves a pair to the CPU. Above AMBIGUOUS, see `threads.pairs`
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
