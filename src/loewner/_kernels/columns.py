"""Columns of the tables that Python fills and kernels read, for pieces and joints, and sizes that both use."""

# -- pieces, described in `pieces.shapes` ----------------------------------------------------------

# Kinds above POLYTOPE are curved. Kinds below MAPPED are surfaces; for kernels, the points of a surface are the corners
# of a box around it.
SOLID, SURFACE, MAPPED = -3, -2, -1
POLYTOPE, ELLIPSOID, CYLINDER, CONE, SEGMENT, POINT = 0, 1, 2, 3, 4, 5

# Eight columns (one cache line) each for the spheres, the outer ellipsoids and the inner ellipsoids.
OUTER_CENTER = 0
OUTER_RADIUS = 3  # upper bound on the largest semi-axis of the outer ellipsoid
INNER_CENTER = 4
REACH = 7  # upper bound on the distance from the body's origin to any point of the piece or its ellipsoids
OUTER_SHAPE = 8
INNER_SIGMA = 14  # lower bound on the smallest semi-axis of the inner ellipsoid
OUTER_SIGMA = 15  # lower bound on the smallest semi-axis of the outer ellipsoid
INNER_SHAPE = 16
INVERSE_INNER_SIGMA = 22  # upper bound on 1 / INNER_SIGMA
HOT = 24  # the vectorised stages read only the columns before this one
ROUNDING = 24  # radius of the ball added to the core
FRAME_CENTER, FRAME_FACTOR = 25, 28  # c and F (row by row): F x + c maps a unit shape to the core
COLUMNS = 37

KIND, POINTS_FROM, POINTS_TO, SURFACE_AT, LAYOUT = 0, 1, 2, 3, 4
PLANES_FROM, PLANES_TO = 3, 4  # columns of the stored layout only, since no kernel needs the planes

# Columns of a piece's row in `part_start`, if there are surfaces; each column contains the index of a row of `parts`.
PART_OUTER, PART_INNER, PART_STOP, PARTS = 0, 1, 2, 3

BLOCK = 8  # points in a block, see `pieces.support`
CACHE_LINE = 64  # bytes

# A polytope with more than LARGE vertices is MAPPED. With fewer, searching all vertices is as fast as using a map.
LARGE = 128
DEEPEST = 14  # limit on divisions of a cell, since the vertices of a flat face share the cells around the face's normal
GRID = 1 << DEEPEST

WIDE = 8  # boxes in a group of a tree
NODE_BITS = 4  # binary logarithm of the number of boxes in a node of a tree over triangles
FEW = 8  # a body with fewer pieces has no tree: each piece is tried

# -- robots, described in `robots.kinematics` and `robots.placement` -------------------------------

FIXED, REVOLUTE, PRISMATIC, PLANAR, FLOATING, BALL = 0, 1, 2, 3, 4, 5
ROTATION, TRANSLATION, SINE, COSINE, ACROSS, ALONG, CONSTANTS = 0, 9, 12, 21, 30, 33, 36

BOUNDS = 8  # columns of a row of bounds

# -- robots on a GPU, described in `threads.configurations` ----------------------------------------

# Columns of a link's int32 row, and columns of its float32 row after CONSTANTS; the last name on each line is the
# length of the row.
PARENT_OF_LINK, KIND_OF_LINK, COLUMN_OF_LINK, LINK_INTEGERS = 0, 1, 2, 4
MULTIPLIER, OFFSET, BENT, LINK_CONSTANTS = CONSTANTS, CONSTANTS + 1, CONSTANTS + 2, 40

# Columns of a body's int32 row, and of a moving body's ball: center, radius, largest distance from the body's origin.
LINK_OF_BODY, FIRST_PIECE, LAST_PIECE, BODY_INTEGERS = 0, 1, 2, 4
BALL_RADIUS, BALL_REACH, BALL_NUMBERS = 3, 4, 8

# Columns of a placed link: its rotation by rows, its translation, and bounds on the errors of both, in roundoffs.
LINK_AT, TURN_OFF, SHIFT_OFF, LINK_NUMBERS = 9, 12, 13, 14

# For searches, a piece's int32 row holds its kind, its first vertex, and the index after its last vertex. Its float32
# row holds the center and factor of a curved core, the radius of the added ball, and the reach.
CORE_KIND, CORE_START, CORE_STOP, CORE_INTEGERS = 0, 1, 2, 4
CORE_CENTER, CORE_FACTOR, CORE_RADIUS, CORE_REACH, CORE_NUMBERS = 0, 3, 12, 13, 16

# In a motion, the row of a pair of bodies holds the moving body, the body in whose frame planes are fixed, and the row
# of its chain. The row of a joint holds its column, whether it turns, its multiplier, its offset and its lever.
UPPER, LOWER, CHAIN, ROLES = 0, 1, 2, 4
TURNING_JOINT, CHAIN_INTEGERS = 1, 2
LEVER, CHAIN_NUMBERS = 2, 4

# -- planners: state of the search for a path ------------------------------------------------------

ITERATION = 0
STARTS, GOALS = 1, 2  # numbers of configurations in the trees from the start and from the goals
OF_START, OF_GOAL = 3, 4  # nodes at which the trees met
MOTIONS = 5  # number of motions that were tried
RANDOM = 6  # state of the random numbers
POSES, SEARCHES, STEPS_LEFT = 7, 8, 9  # tally of the proofs: poses, searches and remaining steps, see `robots.motions`
ROWS = 10  # number of rows of the path, once the trees have met
STATE = 11
STEP, BOUND, GAP = 0, 1, 2  # entries of `records.Search.reach`
TREE_ROWS = 5  # rows in the memory of both trees, besides the values of their nodes

# -- inverse kinematics, described in `robots.reach` ------------------------------------------------

# Columns of a joint's int64 row, which also has KIND_OF_LINK and COLUMN_OF_LINK from above, and columns of its row of
# constants.
MOVES_OF_LINK, LINK_OF_CHAIN = 0, 3
AXIS, CHAIN_CONSTANTS = LINK_CONSTANTS, LINK_CONSTANTS + 3

LEAST, MOST, HOW, RANGE = 0, 1, 2, 3  # rows of the ranges of values
PLAIN, HELD, WRAPS, FAR, TURNS, REST = 0, 1, 2, 3, 4, 5  # entries of the row HOW: how a value moves
