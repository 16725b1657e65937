"""Confidence intervals of counted proportions."""

import math

NORMAL_QUANTILE = 1.959963984540054  # for two-sided intervals of 95 %


def wilson(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % interval of a proportion, by Wilson's score; (0, 1) if nothing was counted.

    References
    ----------
    Wilson (1927), doi:10.1080/01621459.1927.10502953.
    """
    if total == 0:
        return 0.0, 1.0
    z, share = NORMAL_QUANTILE, count / total
    scale = 1.0 / (1.0 + z * z / total)
    middle = scale * (share + z * z / (2 * total))
    half = scale * z * math.sqrt(share * (1 - share) / total + z * z / (4 * total * total))
    # For counts of 0 and `total`, one end is exactly 0 or 1; rounding must not put the proportion outside.
    return max(0.0, min(middle - half, share)), min(1.0, max(middle + half, share))
