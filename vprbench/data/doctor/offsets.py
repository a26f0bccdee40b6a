"""By how many places one traverse is shifted against another, told from very small pictures of their frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

Small = npt.NDArray[np.uint8]  # (n_images, 16, 32), grey
Descriptors = npt.NDArray[np.float32]  # (n, 512), unit rows; a row of zeros if there is no picture
Middles = npt.NDArray[np.int64]  # (n_queries,), the middle right place of each
Likeness = npt.NDArray[np.float32]  # (n_queries, 2 REACH + 1), of the places around the middle; nan: no such place
Shifts = npt.NDArray[np.int64]  # (n_queries,), numbers of places

HEIGHT, WIDTH = 16, 32
REACH = 20  # places to either side of the ground truth that every single query is compared with

_PATCH = 8
_NOISE = 2.0  # of 255 grey values: what differs less in a patch is no structure
_CHANGE_COST = 20.0  # nats, of one more change of the shift along a traverse
_STRETCHES = 30
_BLOCK = 20  # queries; neighbours look alike, so their evidence counts as less than its number
_DIMENSIONS_AT_ONCE = 64
_COVERED = 0.5  # share of the queries that a shift must leave with a place to be believed of the whole traverse
_CHANCE = 1e-4
_LEAST_STRETCHES = 5


@dataclass(frozen=True)
class Peak:
    """The shift of a whole traverse under which it looks most like another."""

    shift: int  # places
    backwards: bool  # the places of the references count from the last to the first
    likeness: Descriptors  # (n_queries,), under that shift; nan if it leads to no place


def described(small: Small) -> Descriptors:
    """Return patch-normalised frames without what all frames of the traverse share, as unit rows."""
    patches = small.reshape(len(small), HEIGHT // _PATCH, _PATCH, WIDTH // _PATCH, _PATCH).astype(np.float32)
    patches -= patches.mean((2, 4), keepdims=True)
    patches /= patches.std((2, 4), keepdims=True) + _NOISE
    rows = patches.reshape(len(small), HEIGHT * WIDTH)
    rows -= rows.mean(0)
    return _unit(rows)


def of_places(descriptors: Descriptors, places: npt.NDArray[np.int64], n_places: int) -> Descriptors:
    """Return one descriptor per place, (n_places, 512), from the descriptors of the images that show it."""
    summed = np.zeros((n_places, descriptors.shape[1]), np.float32)
    np.add.at(summed, places, descriptors)
    return _unit(summed)


def around(queries: Descriptors, middles: Middles, places: Descriptors) -> Likeness:
    """Return how alike each query is to the places up to REACH before and behind its right one."""
    return np.stack([under(queries, middles + shift, places) for shift in range(-REACH, REACH + 1)], axis=1)


def under(queries: Descriptors, shown: Middles, places: Descriptors) -> Descriptors:
    """Return how alike each query is to the place it is said to show; nan if there is no such place."""
    there = (shown >= 0) & (shown < len(places))
    likeness = np.full(len(queries), np.nan, np.float32)
    likeness[there] = np.einsum("ij,ij->i", queries[there], places[shown[there]])
    return likeness


def shifts_along(likeness: Likeness) -> Shifts:
    """Return the most likely shift of every query, given that a shift seldom changes along the traverse.

    The best path through a hidden Markov model (Viterbi 1967) whose states are the shifts; likeness is taken as normal
    around one mean for the right place and another for the others, both estimated here.
    """
    # What a query shares with all places around (darkness, a long bend) speaks for none of them.
    likeness = likeness - np.nanmean(likeness, 1, keepdims=True)
    covered = np.isfinite(likeness).mean(0) >= _COVERED
    per_shift = np.nanmean(likeness[:, covered], 0)
    right = float(per_shift.max())
    wrong = float(np.delete(per_shift, per_shift.argmax()).mean())
    weight = (right - wrong) / _variance(likeness[:, covered] - per_shift)
    evidence = np.nan_to_num(weight * (likeness - (right + wrong) / 2), nan=0.0)
    best = np.zeros(evidence.shape[1])
    came_from = np.empty(evidence.shape, np.int64)
    stay = np.arange(evidence.shape[1])
    for query, gain in enumerate(evidence):
        leader = int(best.argmax())
        came_from[query] = np.where(best[leader] - _CHANGE_COST > best, leader, stay)
        best = best[came_from[query]] - np.where(came_from[query] == stay, 0.0, _CHANGE_COST) + gain
    path = np.empty(len(evidence), np.int64)
    state = int(best.argmax())
    for query in range(len(evidence) - 1, -1, -1):
        path[query] = state
        state = int(came_from[query, state])
    return path - REACH


def peak(queries: Descriptors, middles: Middles, places: Descriptors) -> Peak:
    """Return the one shift, of any size and in either direction of travel, that fits the whole traverse best.

    At least half of the queries have a place under it.
    """
    n_places = len(places)
    length = scipy.fft.next_fast_len(2 * n_places, real=True)
    forwards, backwards = np.zeros(length, np.float32), np.zeros(length, np.float32)
    for start in range(0, places.shape[1], _DIMENSIONS_AT_ONCE):
        part = slice(start, start + _DIMENSIONS_AT_ONCE)
        shown = np.zeros((n_places, queries[:, part].shape[1]), np.float32)
        np.add.at(shown, middles, queries[:, part])
        asked = scipy.fft.rfft(shown, length, 0).conj()
        forwards += scipy.fft.irfft((asked * scipy.fft.rfft(places[:, part], length, 0)).sum(1), length)
        backwards += scipy.fft.irfft((asked * scipy.fft.rfft(places[::-1, part], length, 0)).sum(1), length)
    shifts = np.arange(-n_places + 1, n_places)
    covered = _covered(middles, n_places, shifts)
    enough = covered >= _COVERED * len(middles)
    means = np.array([forwards[shifts] / np.maximum(covered, 1), backwards[shifts] / np.maximum(covered, 1)])
    direction, best = np.unravel_index(np.where(enough, means, -np.inf).argmax(), means.shape)
    shift = int(shifts[best])
    ordered = places[::-1] if direction else places
    return Peak(shift, bool(direction), under(queries, middles + shift, ordered))


def stretches_won(better: Descriptors, worse: Descriptors) -> tuple[int, int, bool]:
    """Compare two likenesses of the same queries, stretch by stretch of the traverse.

    Returns in how many stretches the first is larger, how many there are, and whether a paired t-test over them leaves
    chance less than one in 10,000 (stretches, because neighbouring frames are no independent evidence).
    """
    from scipy.special import stdtr  # scipy.stats takes long to import, and every run would wait

    difference = better - worse
    difference = difference[np.isfinite(difference)]
    count = min(_STRETCHES, len(difference) // 3)
    if count < _LEAST_STRETCHES:
        return 0, count, False
    means = np.array([stretch.mean() for stretch in np.array_split(difference, count)])
    spread = float(means.std(ddof=1)) / np.sqrt(count)
    t = means.mean() / max(spread, 1e-9)
    return int((means > 0).sum()), count, bool(stdtr(count - 1, -t) < _CHANCE)


def _covered(middles: Middles, n_places: int, shifts: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return for each shift how many queries still have a place under it."""
    ordered = np.sort(middles)
    first = np.searchsorted(ordered, -shifts, side="left")
    last = np.searchsorted(ordered, n_places - shifts, side="left")
    return last - first


def _variance(residuals: Likeness) -> float:
    """Return the variance of one query's evidence, as large as that of the mean of neighbours says."""
    single = float(np.nanvar(residuals))
    whole = len(residuals) // _BLOCK * _BLOCK
    if not whole:
        return single + 1e-6
    blocks = np.nan_to_num(residuals[:whole]).reshape(-1, _BLOCK, residuals.shape[1]).mean(1)
    return max(single, _BLOCK * float(blocks.var())) + 1e-6


def _unit(rows: Descriptors) -> Descriptors:
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    unit: Descriptors = np.divide(rows, norms, out=np.zeros_like(rows), where=norms > 1e-6)
    return unit
