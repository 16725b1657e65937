"""Code that planners share: random numbers, and whether a straight motion is free, proven or sampled."""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import FREE, NO_LIMIT
from loewner._kernels.columns import RANDOM
from loewner._kernels.pieces.pack import problem_of
from loewner._kernels.robots.configurations import check_motion
from loewner._kernels.robots.kinematics import quaternion_of
from loewner._kernels.robots.lines import keeps_axis
from loewner._kernels.robots.motions import STEPS_LEFT, certified, make_ready
from loewner._kernels.simd.memory import Arena, Place, floats, integers, sizes_of, small_integers

# Two orientations count as half a turn apart if the cosine of half the angle between them is at most NEARLY_HALF_TURN.
# In this case, rounding decides in which direction `Robot.between` turns.
NEARLY_HALF_TURN = 1e-9

# Constants of the random number generator splitmix64, which passes the usual tests of randomness. Its state is a single
# 64-bit word.
_GAMMA, _FIRST, _SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


class Judge(NamedTuple):
    """The criterion by which a motion counts as free.

    Attributes
    ----------
    pack, problem, tables : handles, see `motions.certify_motions`
    memory : address of the memory for the kernels that prove or sample motions
    tolerance : m, see `motions.certify_motions`
    resolution : largest distance between two samples; 0 if motions are proven instead
    samples : Place of memory for the samples of the longest motion
    error : address of the deviations of values that a proof allows for; 0 for no deviation
    kept : handle of a `records.KeptAxis`; 0 if no axis is kept
    """

    pack: Any
    problem: Any
    tables: Any
    memory: Any
    tolerance: Any
    resolution: Any
    samples: Any
    error: Any
    kept: Any


class Counts(NamedTuple):
    """Number of samples of the longest motion, and number of pairs of bodies."""

    samples: Any
    pairs: Any


_SAMPLES, _PAIRS = sizes_of(Counts)
_MEMORY = Arena(fractions=floats(_SAMPLES), verdicts=small_integers(_SAMPLES), hits=integers(_PAIRS))
_fractions_of, _verdicts_of, _hits_of = _MEMORY.accessors("fractions verdicts hits")
_size = _MEMORY.sizing()


@inline
def _counts_of(handles):
    return Counts(handles[4], len(problem_of(handles[1]).pairs))


@inline
def sample_memory(handles):
    """Make the bytes for `judge_of`, which must live as long as the judge."""
    return np.empty(_size(_counts_of(handles)), np.uint8)


@inline
def judge_of(handles, lengths, dof, samples):
    """Make a judge of motions.

    Parameters
    ----------
    handles : ndarray of int64, shape (7,)
        Handles of the packed bodies, the problem, the tables and the memory, see `Judge`; the number of samples of the
        longest motion; then `error` and `kept`.
    lengths : ndarray, shape (2,)
        Tolerance and resolution.
    dof : int
    samples : int
        Address of the bytes that `sample_memory` made.
    """
    pack, problem, tables, memory = handles[0], handles[1], handles[2], handles[3]
    if lengths[1] == 0.0:
        make_ready(pack, problem, tables, dof, memory)
    place = Place(samples, _counts_of(handles))
    return Judge(pack, problem, tables, memory, lengths[0], lengths[1], place, handles[5], handles[6])


@inline
def random(state):
    """Draw a number from 0 (included) to 1 (excluded); `state` is described in `columns`."""
    bits = np.uint64(state[RANDOM]) + _GAMMA
    state[RANDOM] = np.int64(bits)
    bits = (bits ^ (bits >> _S30)) * _FIRST
    bits = (bits ^ (bits >> _S27)) * _SECOND
    return np.float64((bits ^ (bits >> _S31)) >> _S11) * 2.0**-53


@inline
def _coarse_first(parts, fractions):
    """Write the fractions of samples in the order of `coarse_first` in `edges`: 0, 1, the middle, quarters, etc."""
    fractions[0], fractions[1] = 0.0, 1.0
    digits, count = 1, 2
    while (parts - 1) >> digits != 0:
        digits += 1
    for number in range(1, 1 << digits):
        place = 0
        for k in range(digits):
            place |= ((number >> k) & 1) << (digits - 1 - k)
        if place < parts:
            fractions[count] = place / parts
            count += 1
    return count


@njit()
def _looks_free(judge, ends):
    """Return whether all sampled configurations are free."""
    squares = 0.0
    for c in range(ends.shape[1]):
        squares += (ends[1, c] - ends[0, c]) * (ends[1, c] - ends[0, c])
    parts = np.int64(max(np.ceil(np.sqrt(squares) / judge.resolution), 1.0))
    fractions, verdicts, hits = _fractions_of(judge.samples), _verdicts_of(judge.samples), _hits_of(judge.samples)
    if parts + 1 > len(fractions):
        return False
    count = _coarse_first(parts, fractions)
    verdict, _ = check_motion(
        ends[0], ends[1], fractions[:count], judge.pack, judge.problem, verdicts, hits, judge.memory
    )
    return verdict == FREE


@inline
def turns_clearly(tree, ends):
    """Give quaternions the sign that `Robot.between` uses; return False if rounding decides the sign."""
    clear = True
    for link in range(tree.kind.size):
        at, cosine = quaternion_of(tree, link), 0.0
        if at >= 0:
            for k in range(at, at + 4):
                cosine += ends[0, k] * ends[1, k]
            clear = clear and abs(cosine) > NEARLY_HALF_TURN
            if cosine < 0.0:
                for k in range(at, at + 4):
                    ends[1, k] = -ends[1, k]
    return clear


@apart
def is_free(judge, ends, tally):
    """Return whether the straight motion between two configurations is free; an unsettled motion is not.

    Parameters
    ----------
    judge : Judge
    ends : ndarray, shape (2, dof)
    tally : ndarray of int64, shape (3,)
        Documented in `motions.certified`; proofs may take any number of steps.
    """
    if judge.kept != 0 and not keeps_axis(judge.kept, ends):
        return False
    if judge.resolution > 0.0:
        return _looks_free(judge, ends)
    if not turns_clearly(problem_of(judge.problem).tree, ends):
        return False
    tally[STEPS_LEFT] = NO_LIMIT
    return certified(judge.pack, judge.problem, judge.tables, judge.tolerance, judge.error, ends, tally, judge.memory)
