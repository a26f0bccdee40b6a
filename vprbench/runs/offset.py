"""The offset of a drive whose camera looks elsewhere, told from its queries: `views=auto`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Scores
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.metrics.intervals import FEWEST, difference_interval
from vprbench.runs.viewpoints import Viewed, Viewpoint, Viewpoints

_STEP = 1 / 64  # of the width: the least shift that `auto` tries
_STEPS = 19  # the furthest offset, to either side
_REACH = 24  # the furthest shift that is looked at, beside the furthest offset
_CLEAR = 4  # steps from which another shift shows nothing of the same offset
_MOVES = 4  # shifts to either side of an offset that it is compared with
_FOLDS = 5  # parts of the queries, each of which judges the offset that the others choose
_GAINS = ("gain_over_frame_at_least", "gain_over_others_at_least", "gain_over_chance_at_least")
_SPREADS = (1, 2, 3, 4)  # steps from an offset to the views beside it, for drives that swing
_BLOCK = 64  # queries scored together while an offset is looked for

ZScores = npt.NDArray[np.float64]  # (n_shifts, n_queries)
Steps = tuple[int, ...]  # of the views of one query


@dataclass(frozen=True)
class Offset:
    """Which views `auto` chose, and why."""

    views: tuple[Viewpoint, ...]
    evidence: Mapping[str, Any]


def find_offset(method: Method, queries: Images, options: Viewpoints) -> Offset:
    """Tell the offset of a drive from its first queries, without ground truth; the frames as they are if none is told.

    A query's evidence for a shift is how far its best place stands above the others, in standard deviations. Tried are
    all shifts to one side, and all to both sides, of which the better view counts. Evidence is what a shift has beyond
    the shifts beside it, which must be most of it: frames that look odd to a method raise all shifts around, an offset
    itself alone. Each fifth of the queries judges the offset that the other fifths choose: it must show more than the
    frame itself, than the best offset elsewhere, and, if it is less than 4 steps, than as many views show by chance, in
    intervals that allow for neighbouring queries. An offset to one side is shown with views beside it if they add more
    than chance does, by such an interval too.
    """
    count = len(queries) if options.queries is None else min(options.queries, len(queries))
    z = np.concatenate([*_z_scores(method, queries[:count])], axis=1)
    return offset_of(z)


def offset_of(z: ZScores) -> Offset:
    """Return the offset by the evidence of shifts of -24 to 24 steps, (49, n_queries)."""
    offsets: list[Steps] = [(0,), *(one for k in range(1, _STEPS + 1) for one in ((k,), (-k,), (-k, k)))]
    contrasts = np.array([_contrast(z, views) for views in offsets])
    best = offsets[int(contrasts.mean(1).argmax())]
    gains = _gains_by_folds(z, offsets, contrasts) if z.shape[1] >= FEWEST else dict.fromkeys(_GAINS)
    sharp = 2 * contrasts.mean(1).max() > _beyond_chance(z, best, best).mean()
    told = bool(best != (0,) and sharp and all(low is not None and low > 0 for low in gains.values()))
    evidence = {
        "queries": z.shape[1],
        "shifts": [step * _STEP for step in range(-_REACH, _REACH + 1)],
        "mean_evidence": [float(each) for each in z.mean(1)],
        "best_shift": best[-1] * _STEP,
        "better_than_the_frame": float((_best(z, best) > z[_REACH]).mean()),
        **gains,
        "both_sides": len(best) == 2 if told else None,
    }
    steps = (0,) if not told else best if len(best) == 2 else _with_neighbours(z, best[0])
    return Offset(tuple(Viewpoint(step * _STEP) for step in steps), evidence)


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
    lows = (difference_interval(*pair) for pair in zip(chosen, others, strict=True))
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


def _z_scores(method: Method, queries: Images) -> Iterator[ZScores]:
    """Yield for blocks of queries how far the best place stands above the others, at each shift."""
    done = 0
    for block in queries.blocks(_BLOCK):
        found = []
        for step in range(-_REACH, _REACH + 1):
            one = Viewed(method, [Viewpoint(step * _STEP)])
            found.append(_above_others(one.match(one.encode(block))))
        done += len(block)
        progress.report("looking for an offset", done / len(queries))
        yield np.array(found)


def _above_others(scores: Scores) -> npt.NDArray[np.float64]:
    """Return by how many standard deviations the best place is above the mean of a query's candidates, (n_queries,)."""
    there = scores > -math.inf
    known = np.where(there, scores, 0.0).astype(np.float64)
    counts = np.maximum(there.sum(1), 1)
    means = known.sum(1) / counts
    spread = np.sqrt(np.where(there, (known - means[:, None]) ** 2, 0.0).sum(1) / counts)
    best = np.where(there.any(1), np.where(there, scores, -math.inf).max(1), means)
    return np.asarray((best - means) / np.where(spread > 0, spread, 1.0))
