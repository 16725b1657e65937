"""Bounds on rounding, and tolerances, that kernels and Python share; numbers refer to docs/certified.md."""

UNIT_ROUNDOFF = 2.0**-53
SINGLE_ROUNDOFF = 2.0**-24

# Bounds on the rounding errors of products with a shape matrix Q that was formed from its factor and rotated: errors of
# squared widths nᵀQn in units of trace(Q) |n|², and errors of Qn in units of trace(Q) |n|.
SHAPE_ROUNDINGS = 128.0 * UNIT_ROUNDOFF  # certified.md B1, B2

# Bound on the errors of positions (translation, rotated center, dot product), in units of the sum of the lengths that
# were added.
POSITION_ROUNDINGS = 64.0 * UNIT_ROUNDOFF  # certified.md B3, B14, B19, B30, B33, B34, B49, B53
POSITION_ERROR = POSITION_ROUNDINGS / UNIT_ROUNDOFF  # certified.md B6

# Largest allowed absolute value of an entry of RᵀR - 1. The tolerance accepts poses that passed through float32 (each
# product of poses then adds about 1e-7), but no intended scale or shear.
ROTATION_TOLERANCE = 1e-6

# Factor that rounds up lengths, bounds and their sums in single precision.
UP = 1.0 + 2.0**-22  # certified.md B8

# Bound on the error of centers after they are rounded to single precision, relative to the lengths from which they are
# computed.
OFF = POSITION_ERROR * SINGLE_ROUNDOFF  # certified.md B7, B48

# Tolerances for the vertices of a face of a hull. A vertex may lie inside its own face by at most the sum of two terms:
# FACE_WIDTH times the width of the piece along the normal, and FACE_ROUNDING times the error bound of the dot product.
FACE_WIDTH = 1e-11
FACE_ROUNDING = 64.0

# Factor by which the lengths of chains are enlarged, to allow for rounding, and for stretching by the pose of a base or
# of a body, because such a pose is rigid only to within a tolerance.
CHAIN_STRETCH = 1.0 + 8.0 * ROTATION_TOLERANCE

# Relative allowance in rates and bounds for a few dozen roundings, and for poses that are accepted as rigid although
# they stretch paths slightly.
STRETCH = 1e-5  # certified.md B29

# Limit on the square of a vector's length. Smaller squares have lost digits, so dividing the vector by the square root
# of such a square would not give a unit vector.
LEAST_SQUARE = 1e-290

LEAST = 1e-15  # A length far below all others; adding it keeps squares from underflowing.

PAPER_ANGLE = 0.01  # Tolerance [rad] that the paper uses for the method of Lin and Han.
