"""Columns of the tables for pieces and joints that Python fills and kernels read, and sizes that both use."""

# -- pieces, described in `pieces.shapes` ----------------------------------------------------------

# Numbers of the kinds of pieces. Pieces are curved if the number is above POLYTOPE, and surfaces if it is below MAPPED.
# For a surface, the tables contain the corners of a box around it instead of its own points.
SOLID, SURFACE, MAPPED = -3, -2, -1
POLYTOPE, ELLIPSOID, CYLINDER, CONE, SEGMENT, POINT = 0, 1, 2, 3, 4, 5

# Columns of a piece: eight (one cache line) each for the spheres, for the outer ellipsoid and for the inner ellipsoid.
OUTER_CENTER = 0
OUTER_RADIUS = 3  # Upper bound on the largest semi-axis of the outer ellipsoid.
INNER_CENTER = 4
REACH = 7  # Upper bound on the distance from the body's origin to any point of the piece or its ellipsoids.
OUTER_SHAPE = 8
INNER_SIGMA = 14  # Lower bound on the smallest semi-axis of the inner ellipsoid.
OUTER_SIGMA = 15  # Lower bound on the smallest semi-axis of the outer ellipsoid.
INNER_SHAPE = 16
INVERSE_INNER_SIGMA = 22  # Upper bound on 1 / INNER_SIGMA.
HOT = 24  # Number of leading columns that the vectorised stages read; they read no other columns.
ROUNDING = 24  # Radius of the ball that is added to the core.
# First columns of the vector c and of the matrix F, stored row by row. The map F x + c takes a unit shape to the core.
FRAME_CENTER, FRAME_FACTOR = 25, 28
COLUMNS = 37

KIND, POINTS_FROM, POINTS_TO, SURFACE_AT, LAYOUT = 0, 1, 2, 3, 4
PLANES_FROM, PLANES_TO = 3, 4  # These columns exist only in the stored layout, because no kernel needs the planes.

# Columns of a piece's row in `part_start`, if any piece is a surface. Each column contains the index of a row of
# `parts`.
PART_OUTER, PART_INNER, PART_STOP, PARTS = 0, 1, 2, 3

BLOCK = 8  # Number of points in a block, see `pieces.support`.
CACHE_LINE = 64  # Number of bytes in a cache line.

# Largest number of vertices of a POLYTOPE, whose support points are found by a search through all vertices. A polytope
# with more vertices is MAPPED; for a smaller polytope, a map would not be faster than the search.
LARGE = 128
# Largest depth to which the cells of a map are divided. Without this limit, the division would never end at a flat
# face, because the cells around the normal of the face contain all its vertices at every depth.
DEEPEST = 14
GRID = 1 << DEEPEST

WIDE = 8  # Number of boxes in a group of a tree.
NODE_BITS = 4  # Binary logarithm of the number of boxes in a node of a tree over triangles.
FEW = 8  # Smallest number of pieces for which a body has a tree. If there are fewer, each piece is tried.

# -- robots, described in `robots.kinematics` and `robots.placement` -------------------------------

FIXED, REVOLUTE, PRISMATIC, PLANAR, FLOATING, BALL = 0, 1, 2, 3, 4, 5
ROTATION, TRANSLATION, SINE, COSINE, ACROSS, ALONG, CONSTANTS = 0, 9, 12, 21, 30, 33, 36

BOUNDS = 8  # Number of columns in a row of bounds.

# -- robots on a GPU, described in `threads.configurations` ----------------------------------------

# Columns of a link's int32 row, and columns that follow the first CONSTANTS columns in its float32 row. The last name
# on each line is the length of the row.
PARENT_OF_LINK, KIND_OF_LINK, COLUMN_OF_LINK, LINK_INTEGERS = 0, 1, 2, 4
MULTIPLIER, OFFSET, BENT, LINK_CONSTANTS = CONSTANTS, CONSTANTS + 1, CONSTANTS + 2, 40

# Columns of a body's int32 row, and columns of the ball around a moving body. The ball's row contains the center, the
# radius, and the largest distance of the body's points from the body's origin.
LINK_OF_BODY, FIRST_PIECE, LAST_PIECE, BODY_INTEGERS = 0, 1, 2, 4
BALL_RADIUS, BALL_REACH, BALL_NUMBERS = 3, 4, 8

# Columns of a placed link: its rotation (row by row), its translation, and bounds on the errors of both, as multiples
# of SINGLE_ROUNDOFF.
LINK_AT, TURN_OFF, SHIFT_OFF, LINK_NUMBERS = 9, 12, 13, 14

# For searches, a piece's int32 row holds its kind, its first vertex, and the index after its last vertex. The piece's
# float32 row holds the center and factor of a curved core, the radius of the added ball, and the reach.
CORE_KIND, CORE_START, CORE_STOP, CORE_INTEGERS = 0, 1, 2, 4
CORE_CENTER, CORE_FACTOR, CORE_RADIUS, CORE_REACH, CORE_NUMBERS = 0, 3, 12, 13, 16

# For a motion, the row of a pair of bodies holds the moving body, the body to which the planes are fixed, and the row
# of the pair's chain. The int32 row of a joint holds its column and whether it turns; the float32 row holds its
# multiplier, its offset and its lever.
UPPER, LOWER, CHAIN, ROLES = 0, 1, 2, 4
TURNING_JOINT, CHAIN_INTEGERS = 1, 2
LEVER, CHAIN_NUMBERS = 2, 4

# -- planners: state of the search for a path ------------------------------------------------------

ITERATION = 0
STARTS, GOALS = 1, 2  # Numbers of nodes in the tree from the start and in the tree from the goals.
OF_START, OF_GOAL = 3, 4  # Node of each tree at which the trees met.
MOTIONS = 5  # Number of motions that have been tried.
RANDOM = 6  # State of the random number generator.
POSES, SEARCHES, STEPS_LEFT = 7, 8, 9  # Counts from the proofs: poses, searches and steps left, see `robots.motions`.
ROWS = 10  # Number of configurations on the path, once the trees have met.
STATE = 11
STEP, BOUND, GAP = 0, 1, 2  # Indices of the entries of `records.Search.reach`.
TREE_ROWS = 5  # Number of rows in the memory of both trees, in addition to the rows for joint values.

# -- inverse kinematics, described in `robots.reach` ------------------------------------------------

# Columns of a joint's int64 row, which also has the columns KIND_OF_LINK and COLUMN_OF_LINK from above, and columns of
# the joint's row of constants. The last name on each line is the length of the row.
MOVES_OF_LINK, LINK_OF_CHAIN = 0, 3
AXIS, CHAIN_CONSTANTS = LINK_CONSTANTS, LINK_CONSTANTS + 3

LEAST, MOST, HOW, RANGE = 0, 1, 2, 3  # Rows of the table of ranges, and their number.
PLAIN, HELD, WRAPS, FAR, TURNS, REST = 0, 1, 2, 3, 4, 5  # Entries of the row HOW: how a joint value moves.
