"""Bounds on rounding, and tolerances, that kernels and Python share; numbers refer to docs/certified.md."""

UNIT_ROUNDOFF = 2.0**-53
SINGLE_ROUNDOFF = 2.0**-24

# Bounds on the rounding errors of products with a shape matrix Q that was formed from its factor and rotated: errors of
# squared widths nᵀQn in units of trace(Q) |n|², and errors of Qn in units of trace(Q) |n|.
SHAPE_ROUNDINGS = 128.0 * UNIT_ROUNDOFF  # certified.md B1, B2

# Bound on the errors of positions (translation, rotated center, dot product), in units of the lengths that were added.
POSITION_ROUNDINGS = 64.0 * UNIT_ROUNDOFF  # certified.md B3, B14, B19, B30, B33, B34, B49, B53
POSITION_ERROR = POSITION_ROUNDINGS / UNIT_ROUNDOFF  # certified.md B6

# Allowed deviation of RᵀR from the identity (largest entry). ROTATION_TOLERANCE admits poses that passed through
# float32 (about 1e-7 for each product), but no intended scale or shear.
ROTATION_TOLERANCE = 1e-6

# In single precision, the factor UP rounds up lengths, bounds and their sums.
UP = 1.0 + 2.0**-22  # certified.md B8

# Bound on the error of centers after they are rounded to single precision, relative to the lengths from which they are
# computed.
OFF = POSITION_ERROR * SINGLE_ROUNDOFF  # certified.md B7, B48

# A vertex of a hull may lie inside its own face by FACE_WIDTH times the width of the piece along the normal, or by
# FACE_ROUNDING times the error bound of the dot product.
FACE_WIDTH = 1e-11
FACE_ROUNDING = 64.0

# The factor CHAIN_STRETCH allows for rounding, and for stretching by the pose of a base or a body, which is rigid only
# to within a tolerance.
CHAIN_STRETCH = 1.0 + 8.0 * ROTATION_TOLERANCE

# The fraction STRETCH allows for poses that are accepted as rigid but stretch paths slightly, and for a few dozen
# roundings of rates and bounds.
STRETCH = 1e-5  # certified.md B29

# Squares of lengths below LEAST_SQUARE have lost digits, so dividing by their roots does not give a unit vector.
LEAST_SQUARE = 1e-290

LEAST = 1e-15  # LEAST, a length far below all others, keeps squares from underflowing.

PAPER_ANGLE = 0.01  # The paper's tolerance for Lin-Han [rad].
