"""The offset of a drive whose camera looks elsewhere, told from its queries: `views=auto`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Scores
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.metrics.intervals import FEWEST, difference_interval
from vprbench.runs.viewpoints import AS_IT_IS, Viewed, Viewpoint, Viewpoints

_AXES = ("horizontal", "vertical", "zoom")
_STEP = 1 / 64  # of the width or height: the least shift that `auto` tries
_ZOOM_STEP = 1.03  # times: the least zoom
_STEPS = 19  # the furthest offset, to either side
_REACH = 24  # the furthest step that is looked at, beside the furthest offset
_CLEAR = 4  # steps from which another view shows nothing of the same offset
_MOVES = 4  # steps to either side of an offset that it is compared with
_FOLDS = 5  # parts of the queries, each of which judges the offset that the others choose
_CONFIDENCE = 1 - 0.05 / len(_AXES)  # of each gain, as all axes are looked at
_GAINS = ("gain_over_frame_at_least", "gain_over_others_at_least", "gain_over_chance_at_least")
_SPREADS = (1, 2, 3, 4)  # steps from an offset to the views beside it, for drives that swing
_MOST = 3  # views of a query
_GROUP = 64  # queries scored together while an offset is looked for, at most
_FEWEST_QUERIES = 200  # fewer tell no offset
_COARSE_QUERIES = 200  # the first ones, by which another start is chosen
_COARSE_GAIN = 0.5  # standard deviations that each shift of another start must gain
_COARSE = range(-18, 19, 3), range(-16, 17, 4)  # starts: steps to the right and down

ZScores = npt.NDArray[np.float64]  # (n_views, n_queries)
Steps = tuple[int, ...]  # of the views of one query


@dataclass(frozen=True)
class Offset:
    """Which views `auto` chose, and why."""

    views: tuple[Viewpoint, ...]
    evidence: Mapping[str, Any]


@dataclass(frozen=True)
class Told:
    """What the evidence along one axis tells."""

    steps: Steps  # of the views that it chooses: (0,) if no offset is told
    gain: float  # over no offset, at least; 0 if none is told
    evidence: Mapping[str, Any]


def find_offset(method: Method, queries: Images, options: Viewpoints) -> Offset:
    """Tell the offset of a drive from its first queries, without ground truth; the frames as they are if none is told.

    Looked at are shifts of the width, shifts of the height, and zooms, each axis as in `told_along`. The axis that
    gains most is moved along first, and the others are looked at again from there, until none tells an offset. Two
    shifts may hide each other: if the best one of a coarse grid is elsewhere, it is another start, which counts if
    each of its shifts gains more than half a standard deviation from there. No more than 3 views are chosen.
    Fewer than 200 queries tell nothing.
    """
    seen = queries if options.queries is None else queries[: options.queries]
    if len(seen) < _FEWEST_QUERIES:
        return Offset((AS_IT_IS,), {"queries": len(seen)})
    found = _moved_along(method, seen, AS_IT_IS)
    start = _coarse_start(method, seen[:_COARSE_QUERIES])
    if not any(_near(view, start) for view in (AS_IT_IS, *found.views)):
        other = _moved_along(method, seen, start, _COARSE_GAIN)
        gains = [other.told[axis].gain for axis in _AXES if getattr(start, axis) != getattr(AS_IT_IS, axis)]
        found = other if min(gains) > _COARSE_GAIN else found
    return Offset(found.views, {"queries": len(seen), **{axis: found.told[axis].evidence for axis in _AXES}})


@dataclass(frozen=True)
class _Found:
    views: tuple[Viewpoint, ...]
    told: Mapping[str, Told]  # by axis


def _moved_along(method: Method, queries: Images, start: Viewpoint, least: float = 0.0) -> _Found:
    """Return the views after all axes that gain more than `least` from a start, and what each axis told last."""
    views: tuple[Viewpoint, ...] = (start,)
    told: dict[str, Told] = {}
    left = list(_AXES)
    while left:
        for axis in left:
            ways = [[_at(view, axis, step) for view in views] for step in range(-_REACH, _REACH + 1)]
            told[axis] = told_along(_z_scores(method, queries, ways), _MOST // len(views))
        axis = max(left, key=lambda axis: told[axis].gain)
        if told[axis].gain <= least:
            break
        views = tuple(_at(view, axis, step) for view in views for step in told[axis].steps)
        left.remove(axis)
    return _Found(views, told)


def _coarse_start(method: Method, queries: Images) -> Viewpoint:
    """Return the view of a coarse grid of shifts whose best places stand out most from those of its row and column."""
    grid = [Viewpoint(right * _STEP, down * _STEP) for right, down in itertools.product(*_COARSE)]
    means = _z_scores(method, queries, [[view] for view in grid]).mean(1).reshape([*map(len, _COARSE)])
    alone = means - means.mean(0) - means.mean(1, keepdims=True)
    return grid[int(alone.argmax())]


def _near(view: Viewpoint, other: Viewpoint) -> bool:
    """Tell whether two views show some of the same shift."""
    shifts = (view.horizontal - other.horizontal, view.vertical - other.vertical)
    return all(abs(shift) < _CLEAR * _STEP for shift in shifts)


def _at(view: Viewpoint, axis: str, step: int) -> Viewpoint:
    """Return a view moved to a step of an axis."""
    return replace(view, **{axis: _ZOOM_STEP**step if axis == "zoom" else step * _STEP})


def told_along(z: ZScores, most: int = _MOST) -> Told:
    """Return the offset by the evidence of the steps -24 to 24 of an axis, (49, n_queries), in at most so many views.

    A query's evidence for a view is how far its best place stands above the others, in standard deviations, where each
    place is compared with itself under other queries. Tried are all steps to one side, and all to both sides, of which
    the better view counts. Evidence is what a step has beyond the steps beside it, which must be most of it: frames
    that look odd to a method raise all steps around, an offset itself alone. Each fifth of the queries judges the
    offset that the other fifths choose: it must show more than no offset, than the best offset elsewhere, and, if it is
    less than 4 steps, than as many views show by chance, in intervals that allow for neighbouring queries and for three
    axes. An offset to one side is shown with views beside it if they add more than chance does, by such an interval
    too.
    """
    offsets: list[Steps] = [(0,), *(one for k in range(1, _STEPS + 1) for one in ((k,), (-k,), (-k, k)))]
    offsets = [steps for steps in offsets if len(steps) <= most]
    contrasts = np.array([_contrast(z, views) for views in offsets])
    best = offsets[int(contrasts.mean(1).argmax())]
    gains = _gains_by_folds(z, offsets, contrasts) if z.shape[1] >= FEWEST else dict.fromkeys(_GAINS)
    sharp = 2 * contrasts.mean(1).max() > _beyond_chance(z, best, best).mean()
    told = bool(best != (0,) and sharp and all(low is not None and low > 0 for low in gains.values()))
    evidence = {
        "mean_evidence": [float(each) for each in z.mean(1)],
        "best_step": best[-1],
        "better_than_the_frame": float((_best(z, best) > z[_REACH]).mean()),
        **gains,
        "both_sides": len(best) == 2 if told else None,
    }
    if not told:
        return Told((0,), 0.0, evidence)
    steps = _with_neighbours(z, best[0]) if len(best) == 1 and most >= _MOST else best
    return Told(steps, float(gains[_GAINS[0]] or 0), evidence)


def _with_neighbours(z: ZScores, step: int) -> Steps:
    """Return the views of a drive with an offset to one side: of a drive that swings about it with views beside it."""
    alone = _beyond_chance(z, (step,), (step,))
    swings = [(step - spread, step, step + spread) for spread in _SPREADS]
    shown = [_beyond_chance(z, views, views) for views in swings]
    best = int(np.mean(shown, axis=1).argmax())
    more = difference_interval(shown[best], alone)
    return swings[best] if more is not None and more.low > 0 else (step,)


def _gains_by_folds(z: ZScores, offsets: Sequence[Steps], contrasts: ZScores) -> dict[str, float | None]:
    """Return by how much, at least, offsets that other queries chose beat the frame, the best one elsewhere, chance."""
    chosen, others = np.empty((3, z.shape[1])), np.empty((3, z.shape[1]))
    for part in np.array_split(np.arange(z.shape[1]), _FOLDS):
        means = np.delete(contrasts, part, axis=1).mean(1)
        best = int(means.argmax())
        views = offsets[best]
        elsewhere = max((i for i, other in enumerate(offsets) if _clear(other, views)), key=lambda i: float(means[i]))
        chosen[:, part], others[:, part] = contrasts[best, part], contrasts[[0, elsewhere, 0]][:, part]
        if not _clear(views, (0,)):  # it shows what the frame itself shows too, and of two such views one shows more
            for sums, one in ((chosen, views), (others, (0,))):
                sums[2, part] = _beyond_chance(z[:, part], one, (*views, 0))
    lows = (difference_interval(*pair, _CONFIDENCE) for pair in zip(chosen, others, strict=True))
    return {name: None if low is None else low.low for name, low in zip(_GAINS, lows, strict=True)}


def _best(z: ZScores, views: Steps) -> npt.NDArray[np.float64]:
    """Return the evidence of the better view, (n_queries,)."""
    return np.asarray(z[np.array(views) + _REACH].max(0))


def _contrast(z: ZScores, views: Steps) -> npt.NDArray[np.float64]:
    """Return by how much views show more than the same ones moved to the side where these show more, (n_queries,)."""
    moves = [move for move in range(1, 2 * _REACH) if _clear(tuple(view + move for view in views), views)]
    sides = []
    for sign, room in ((1, _REACH - max(views)), (-1, _REACH + min(views))):
        nearest = [sign * move for move in moves if move <= room][:_MOVES]
        sides.append(np.mean([_best(z, tuple(view + move for view in views)) for move in nearest], axis=0))
    return np.asarray(_best(z, views) - max(sides, key=lambda side: float(side.mean())))


def _beyond_chance(z: ZScores, views: Steps, away_from: Steps) -> npt.NDArray[np.float64]:
    """Return by how much views show more than as many do on average that are drawn from all shifts clear of some."""
    others = [step + _REACH for step in range(-_REACH, _REACH + 1) if _clear((step,), away_from)]
    drawn, count = len(views), len(others)
    chances = np.array([math.comb(i, drawn - 1) / math.comb(count, drawn) for i in range(count)])  # to be the best
    return np.asarray(_best(z, views) - chances @ np.sort(z[others], axis=0))


def _clear(views: Steps, others: Steps) -> bool:
    """Tell whether views show nothing of what others show."""
    return all(abs(view - other) >= _CLEAR for view in views for other in others)


def _z_scores(method: Method, queries: Images, ways: Sequence[Sequence[Viewpoint]]) -> ZScores:
    """Return how far the best place stands above the others if queries are asked in each way, from its views.

    Queries are scored in groups, each from the first to the last, so that the queries of a group are of many places.
    """
    z = np.empty((len(ways), len(queries)))
    asked = [Viewed(method, views) for views in ways]
    n_groups = -(-len(queries) // _GROUP)
    for first in range(n_groups):
        group = np.arange(first, len(queries), n_groups)
        images = queries[group].in_memory()
        for row, viewed in zip(z, asked, strict=True):
            row[group] = _above_others(viewed.match(viewed.encode(images)))
        progress.report("looking for an offset", (first + 1) / n_groups)
    return z


def _above_others(scores: Scores) -> npt.NDArray[np.float64]:
    """Return by how many standard deviations the best place is above the mean of a query's candidates, (n_queries,).

    Of each score the mean of its place is taken off: a place that is like all queries says nothing of one of them.
    """
    there = scores > -math.inf
    known = np.where(there, scores, 0.0).astype(np.float64)
    known = np.where(there, known - known.sum(0) / np.maximum(there.sum(0), 1), 0.0)
    counts = np.maximum(there.sum(1), 1)
    means = known.sum(1) / counts
    spread = np.sqrt(np.where(there, (known - means[:, None]) ** 2, 0.0).sum(1) / counts)
    best = np.where(there.any(1), np.where(there, known, -math.inf).max(1), means)
    return np.asarray((best - means) / np.where(spread > 0, spread, 1.0))
