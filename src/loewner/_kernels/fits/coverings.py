"""Choose a few balls or capsules that hold many points: greedily, then by exchanges guided by weights of points.

A matrix of bits, in words of 64, records which candidate holds which point. The matrix is stored twice. By point, bit c
of word w is for candidate 64 w + c; by candidate, bit c of word w is for point 64 w + c. A step can therefore read the
points of one candidate, or the candidates of one point, a word at a time.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.simd.vectors import LANES, bits_set, broadcast, load, maximum, minimum, movemask, next_lane

WORD = 64

# Number of values that describe a candidate: its center (3), half its axis (3), the inverse squared length of half its
# axis, and its radius.
ROWS = 8

# Maximum size of the sample of missed points by which an exchange compares candidates. The exchange chooses one missed
# point, and compares all candidates that hold this point.
SEEN = 128

# STEPS_EACH: maximum number of exchanges for each candidate that was chosen at first. WAITS: number of exchanges, from
# the last change of a candidate on, in which the candidate is exchanged again only if all others changed as recently.
STEPS_EACH, WAITS = 50, 3

# Stride with which successive exchanges choose among the missed points; a prime number.
STRIDE = 7919


@njit()
def find_held(first, points, candidates, by_point, by_candidate):
    """Find which candidates hold the balls about points, for all points from `first`, a multiple of 64.

    Parameters
    ----------
    first : int
    points : ndarray, shape (n, 4)
        Centers and radii.
    candidates : ndarray, shape (8 m,)
        All x of the centers, then all y and z; the x, y and z of half the axes (0 for a ball); the inverse squared
        lengths of half the axes (0 for a ball); and the radii. The number m is a multiple of 64; a candidate with
        radius -1 holds nothing.
    by_point, by_candidate : ndarray of int64, shapes (at least n, m / 64) and (m, at least n / 64)
        Receive the bits.
    """
    n, m = len(points), len(candidates) // ROWS
    tile = np.empty(WORD, np.int64)
    for w in range(m // WORD):
        round_ = True
        for k in range(WORD * w, WORD * w + WORD):
            round_ &= candidates[6 * m + k] == 0.0
        for block in range(first // WORD, (n + WORD - 1) // WORD):
            for i in range(WORD):
                p, bits = WORD * block + i, 0
                if p < n:
                    for lane in range(0, WORD, LANES):
                        bits |= _held(points, p, candidates, m, WORD * w + lane, round_) << lane
                    by_point[p, w] = bits
                tile[i] = bits
            _transpose(tile)
            for k in range(WORD):
                by_candidate[WORD * w + k, block] = tile[k]


@inline
def _held(points, p, candidates, m, at, round_):
    """Bits of eight consecutive candidates: whether each holds a ball."""
    x = points[p, 0] - load(candidates, at)
    y = points[p, 1] - load(candidates, m + at)
    z = points[p, 2] - load(candidates, 2 * m + at)
    if not round_:
        a, b, c = load(candidates, 3 * m + at), load(candidates, 4 * m + at), load(candidates, 5 * m + at)
        share = (x * a + y * b + z * c) * load(candidates, 6 * m + at)
        share = minimum(maximum(share, broadcast(-1.0)), broadcast(1.0))
        x, y, z = x - share * a, y - share * b, z - share * c
    room = load(candidates, 7 * m + at) - points[p, 3]
    return movemask((x * x + y * y + z * z <= room * room) & (room >= 0.0))


@inline
def _transpose(tile):
    """Transpose 64 words of 64 bits: exchange halves of words, then quarters, down to single bits."""
    step, low = 32, 0xFFFFFFFF
    while step > 0:
        for k in range(WORD):
            if k & step == 0:
                moved = ((tile[k] >> step) ^ tile[k + step]) & low
                tile[k] ^= moved << step
                tile[k + step] ^= moved
        step >>= 1
        low ^= low << step


@njit()
def choose_few(count, steps, start, by_point, by_candidate, chosen):
    """Choose a small number of candidates that together hold all points.

    Points that are missed repeatedly gain weight. The weights lead the search out of local minima (Gao, Weise and Li:
    An efficient local search heuristic with row weighting for the unicost set covering problem, 2015).

    Parameters
    ----------
    count : int
        Number of points.
    steps : int
        Largest number of exchanges.
    start : ndarray of int64, shape (k,)
        Candidates that are chosen first, if they hold points that the previous candidates do not hold.
    by_point, by_candidate : ndarray of int64
        Bits, as `find_held` writes them.
    chosen : ndarray of int64, shape (count,)
        Receives the candidates.

    Returns
    -------
    int
        Number of candidates; -1 if there is a point that no candidate holds.
    """
    missed = np.zeros(by_candidate.shape[1], np.int64)
    for p in range(count):
        missed[p // WORD] |= 1 << (p % WORD)
    chosen_count = _greedy(start, by_candidate, missed, chosen)
    for w in range(len(missed)):
        if missed[w] != 0:
            return -1
    return _exchange(count, steps, by_point, by_candidate, missed, chosen, chosen_count) if steps > 0 else chosen_count


@njit()
def _greedy(start, by_candidate, missed, chosen):
    """Repeatedly take the candidate with the most missed points, until none has any; return how many were taken."""
    m, words = by_candidate.shape
    gains, chosen_count = np.zeros(m, np.int64), 0
    for k in start:
        if _drop_held(by_candidate, k, missed):
            chosen[chosen_count] = k
            chosen_count += 1
    for k in range(m):
        for w in range(words):
            gains[k] += bits_set(by_candidate[k, w] & missed[w])
    held, at = np.empty(words, np.int64), np.empty(words, np.int64)
    while True:
        best = 0
        for k in range(1, m):
            if gains[k] > gains[best]:
                best = k
        if gains[best] == 0:
            return chosen_count
        some = 0
        for w in range(words):
            both = by_candidate[best, w] & missed[w]
            if both != 0:
                held[some], at[some] = both, w
                some += 1
        for k in range(m):
            for j in range(some):
                gains[k] -= bits_set(by_candidate[k, at[j]] & held[j])
        _drop_held(by_candidate, best, missed)
        chosen[chosen_count] = best
        chosen_count += 1


@inline
def _drop_held(by_candidate, k, missed):
    """Remove a candidate's points from the missed points; return whether the candidate holds any missed point."""
    any_ = False
    for w in range(len(missed)):
        both = by_candidate[k, w] & missed[w]
        any_ |= both != 0
        missed[w] ^= both
    return any_


@njit()
def _exchange(count, steps, by_point, by_candidate, missed, chosen, found):
    """Reduce, by exchanges, the number of candidates that hold all points; return the number.

    Each step drops a candidate and adds another one that holds a missed point. If no point is missed, candidates are
    dropped first, until a point is missed.
    """
    m = len(by_candidate)
    # For each point: the number of chosen candidates that hold it, and the sum of their indices. If only one candidate
    # holds the point, the sum is the index of this candidate.
    held, holder = np.zeros(count, np.int64), np.zeros(count, np.int64)
    # The weights of the points are integers, stored as floats. The loss of a chosen candidate is the total weight of
    # the points that this candidate holds and that no other chosen candidate holds.
    weight, loss = np.ones(count), np.zeros(m)
    last, now, used = np.full(m, -10), np.empty(found, np.int64), found
    seen, gain = np.empty(count, np.int64), np.zeros(m)
    for j in range(found):
        now[j] = chosen[j]
        _add(by_candidate, now[j], held, holder, weight, loss, missed)
    for step in range(min(steps, STEPS_EACH * found)):
        left = _bits_of(missed, seen)
        while left == 0:
            found = used
            for j in range(used):
                chosen[j] = now[j]
            if used == 1:
                return found
            used = _drop(by_candidate, now, used, last, step, 0, held, holder, weight, loss, missed)
            left = _bits_of(missed, seen)
        if used > 1:
            used = _drop(by_candidate, now, used, last, step, WAITS, held, holder, weight, loss, missed)
            left = _bits_of(missed, seen)
        best = _best_for(seen[step * STRIDE % left], step, by_point, seen, left, weight, last, gain)
        _add(by_candidate, best, held, holder, weight, loss, missed)
        now[used], last[best] = best, step
        used += 1
        for j in range(left):
            if held[seen[j]] == 0:
                weight[seen[j]] += 1.0
    return found


@njit()
def _add(by_candidate, k, held, holder, weight, loss, missed):
    """Choose a candidate, and update all values that depend on the points that it holds."""
    loss[k] = 0.0
    for w in range(len(missed)):
        bits = by_candidate[k, w]
        missed[w] &= ~bits
        while bits != 0:
            lane, bits = next_lane(bits)
            p = WORD * w + lane
            if held[p] == 0:
                loss[k] += weight[p]
            elif held[p] == 1:
                loss[holder[p]] -= weight[p]
            held[p] += 1
            holder[p] += k


@njit()
def _drop(by_candidate, now, used, last, step, waits, held, holder, weight, loss, missed):
    """Drop the candidate with the least loss among all that did not change recently; return how many are left."""
    at, least = 0, np.inf
    for j in range(used):
        k = now[j]
        value = loss[k] + (1e9 if last[k] > step - waits else 0.0)
        if value < least:
            at, least = j, value
    dropped = now[at]
    for j in range(at, used - 1):
        now[j] = now[j + 1]
    last[dropped] = step
    for w in range(len(missed)):
        bits = by_candidate[dropped, w]
        while bits != 0:
            lane, bits = next_lane(bits)
            p = WORD * w + lane
            held[p] -= 1
            holder[p] -= dropped
            if held[p] == 1:
                loss[holder[p]] += weight[p]
            elif held[p] == 0:
                missed[w] |= 1 << lane
    return used - 1


@inline
def _bits_of(words, places):
    """Write the numbers of the bits that are set; return their count."""
    n = 0
    for w in range(len(words)):
        bits = words[w]
        while bits != 0:
            lane, bits = next_lane(bits)
            places[n] = WORD * w + lane
            n += 1
    return n


@njit()
def _best_for(point, step, by_point, missed, left, weight, last, gain):
    """Find the candidate with the most missed weight that holds a point and was not dropped in this step."""
    words, every = by_point.shape[1], (left + SEEN - 1) // SEEN
    for j in range(0, left, every):
        p = missed[j]
        for w in range(words):
            bits = by_point[point, w] & by_point[p, w]
            while bits != 0:
                lane, bits = next_lane(bits)
                gain[WORD * w + lane] += weight[p]
    best, most = -1, -2.0
    for w in range(words):
        bits = by_point[point, w]
        while bits != 0:
            lane, bits = next_lane(bits)
            k = WORD * w + lane
            value = gain[k] if last[k] < step else -1.0
            if value > most:
                best, most = k, value
            gain[k] = 0.0
    return best
