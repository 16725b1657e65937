"""Codes that kernels and queries share."""

FREE, COLLIDING, AMBIGUOUS = 0, 1, 2
CERTIFY, EXACT = 0, 1

# Who settled a piece pair; BY_PLANE: the support planes of the pieces square to the contact normal of their ellipsoids.
BY_SPHERE, BY_OUTER, BY_INNER, BY_PLANE, BY_SEARCH, OPEN = 0, 1, 2, 3, 4, 5
TIERS = 6
UNSURE = TIERS  # no tier: what `certificate.certify` says where a better s may settle a pair
