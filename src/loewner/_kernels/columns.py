"""Columns of the tables for pieces and joints that Python fills and kernels read, and sizes that both use."""

# -- pieces, described in `pieces.shapes` ----------------------------------------------------------

# Kinds above POLYTOPE are curved, and kinds below MAPPED are surfaces. In the tables, the points stored for a surface
# are the corners of a box around it.
SOLID, SURFACE, MAPPED = -3, -2, -1
POLYTOPE, ELLIPSOID, CYLINDER, CONE, SEGMENT, POINT = 0, 1, 2, 3, 4, 5

# The spheres, the outer ellipsoids and the inner ellipsoids take eight columns (one cache line) each.
OUTER_CENTER = 0
OUTER_RADIUS = 3  # Upper bound on the largest semi-axis of the outer ellipsoid.
INNER_CENTER = 4
REACH = 7  # Upper bound on the distance from the body's origin to any point of the piece or its ellipsoids.
OUTER_SHAPE = 8
INNER_SIGMA = 14  # Lower bound on the smallest semi-axis of the inner ellipsoid.
OUTER_SIGMA = 15  # Lower bound on the smallest semi-axis of the outer ellipsoid.
INNER_SHAPE = 16
INVERSE_INNER_SIGMA = 22  # Upper bound on 1 / INNER_SIGMA.
HOT = 24  # The vectorised stages read only the columns before HOT.
ROUNDING = 24  # Radius of the ball that is added to the core.
# The columns of c and, row by row, of F: the map F x + c takes a unit shape to the core.
FRAME_CENTER, FRAME_FACTOR = 25, 28
COLUMNS = 37

KIND, POINTS_FROM, POINTS_TO, SURFACE_AT, LAYOUT = 0, 1, 2, 3, 4
PLANES_FROM, PLANES_TO = 3, 4  # These columns are only in the stored layout, because no kernel needs the planes.

# Columns of a piece's row in `part_start`, if any piece is a surface. Each column contains the index of a row of
# `parts`.
PART_OUTER, PART_INNER, PART_STOP, PARTS = 0, 1, 2, 3

BLOCK = 8  # A block has BLOCK points, see `pieces.support`.
CACHE_LINE = 64  # A cache line has CACHE_LINE bytes.

# A polytope with more than LARGE vertices is MAPPED. For a smaller polytope, searching all vertices is as fast as using
# a map.
LARGE = 128
# Largest depth to which cells are divided. Without a limit, the division would never end at a flat face, because all
# vertices of the face share the cells around its normal.
DEEPEST = 14
GRID = 1 << DEEPEST

WIDE = 8  # A group of a tree has WIDE boxes.
NODE_BITS = 4  # A node of a tree over triangles has 2 ** NODE_BITS boxes.
FEW = 8  # A body with fewer than FEW pieces has no tree: each piece is tried.

# -- robots, described in `robots.kinematics` and `robots.placement` -------------------------------

FIXED, REVOLUTE, PRISMATIC, PLANAR, FLOATING, BALL = 0, 1, 2, 3, 4, 5
ROTATION, TRANSLATION, SINE, COSINE, ACROSS, ALONG, CONSTANTS = 0, 9, 12, 21, 30, 33, 36

BOUNDS = 8  # A row of bounds has BOUNDS columns.

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

# For searches, a piece's int32 row holds its kind, its first vertex, and the index after its last vertex. The piece's
# float32 row holds the center and factor of a curved core, the radius of the added ball, and the reach.
CORE_KIND, CORE_START, CORE_STOP, CORE_INTEGERS = 0, 1, 2, 4
CORE_CENTER, CORE_FACTOR, CORE_RADIUS, CORE_REACH, CORE_NUMBERS = 0, 3, 12, 13, 16

# In a motion, the row of a pair of bodies holds the moving body, the body in whose frame planes are fixed, and the row
# of the pair's chain. The row of a joint holds its column, whether it turns, its multiplier, its offset and its lever.
UPPER, LOWER, CHAIN, ROLES = 0, 1, 2, 4
TURNING_JOINT, CHAIN_INTEGERS = 1, 2
LEVER, CHAIN_NUMBERS = 2, 4

# -- planners: state of the search for a path ------------------------------------------------------

ITERATION = 0
STARTS, GOALS = 1, 2  # Numbers of configurations in the trees from the start and from the goals.
OF_START, OF_GOAL = 3, 4  # Nodes at which the trees met.
MOTIONS = 5  # Number of motions that were tried.
RANDOM = 6  # State of the random numbers.
POSES, SEARCHES, STEPS_LEFT = 7, 8, 9  # Tally of the proofs: poses, searches and remaining steps, see `robots.motions`.
ROWS = 10  # Number of rows of the path, once the trees have met.
STATE = 11
STEP, BOUND, GAP = 0, 1, 2  # Entries of `records.Search.reach`.
TREE_ROWS = 5  # The memory of both trees has TREE_ROWS rows in addition to the values of their nodes.

# -- inverse kinematics, described in `robots.reach` ------------------------------------------------

# Columns of a joint's int64 row, and columns of its row of constants. The int64 row also has the columns KIND_OF_LINK
# and COLUMN_OF_LINK from above.
MOVES_OF_LINK, LINK_OF_CHAIN = 0, 3
AXIS, CHAIN_CONSTANTS = LINK_CONSTANTS, LINK_CONSTANTS + 3

LEAST, MOST, HOW, RANGE = 0, 1, 2, 3  # Rows of the ranges of values.
PLAIN, HELD, WRAPS, FAR, TURNS, REST = 0, 1, 2, 3, 4, 5  # Entries of the row HOW: how a value moves.
