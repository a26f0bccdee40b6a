"""Best settings against the paper's: trained with several seeds, none of them the searched one, on both stretches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from statistics import mean, stdev
from typing import Literal

import numpy as np

from vprbench import progress
from vprbench.metrics.intervals import McNemar, WiderInterval, difference_interval, mcnemar_exact
from vprbench.tuning.objective import StretchName, Task, Tried
from vprbench.tuning.space import PAPER, Values

Verdict = Literal["better", "worse", "not told apart"]

SEEDS = 5
AGREE = 4  # seeds of one sign, at least, for a verdict


@dataclass(frozen=True)
class Repeated:
    """What came of some settings, seed by seed."""

    recalls_at_1: tuple[float, ...]
    diverged: tuple[str | None, ...]  # how the divergence was seen; None: no divergence

    @property
    def recall_at_1(self) -> float:
        """The mean over the seeds."""
        return mean(self.recalls_at_1)

    @property
    def recall_at_1_std(self) -> float:
        """The standard deviation over the seeds, of a sample."""
        return stdev(self.recalls_at_1)


@dataclass(frozen=True)
class Comparison:
    """The best settings and the paper's on the queries of one stretch, both trained with the same seeds."""

    n_places: int
    n_queries: int
    seeds: tuple[int, ...]
    best: Repeated
    paper: Repeated
    interval: WiderInterval | None  # 95 % of the difference over the queries; None: too few queries
    tests: tuple[McNemar, ...]  # by seed, b: only best right

    @property
    def differences(self) -> tuple[float, ...]:
        """R@1 of best minus that of paper, by seed."""
        return tuple(b - p for b, p in zip(self.best.recalls_at_1, self.paper.recalls_at_1, strict=True))

    @property
    def verdict(self) -> Verdict:
        """Whether best is better or worse: the interval has to exclude 0, and nearly all seeds have to agree."""
        if self.interval is None:
            return "not told apart"
        if self.interval.low > 0 and sum(difference > 0 for difference in self.differences) >= AGREE:
            return "better"
        if self.interval.high < 0 and sum(difference < 0 for difference in self.differences) >= AGREE:
            return "worse"
        return "not told apart"


def compare_with_paper(
    executor: Executor,
    attempt: Callable[[Task], Tried],
    best: Values,
    n_places: Mapping[StretchName, int],
    seed: int,
) -> dict[StretchName, Comparison]:
    """Train under the best settings and the paper's with the seeds that follow `seed`, on each stretch.

    Raises what a training raises.
    """
    seeds = tuple(range(seed + 1, seed + 1 + SEEDS))
    tasks = [Task(stretch, values, each) for stretch in n_places for values in (best, PAPER) for each in seeds]
    answers: list[Tried] = []
    for answer in executor.map(attempt, tasks):
        answers.append(answer)
        progress.report("best against paper", len(answers) / len(tasks))
    halves = [answers[first : first + SEEDS] for first in range(0, len(tasks), SEEDS)]
    return {
        stretch: compare(n_places[stretch], seeds, best_ones, paper_ones)
        for stretch, best_ones, paper_ones in zip(n_places, halves[::2], halves[1::2], strict=True)
    }


def compare(n_places: int, seeds: Sequence[int], best: Sequence[Tried], paper: Sequence[Tried]) -> Comparison:
    """Compare how the same queries were answered under both settings, each trained once with each of `seeds`.

    The interval is that of a paired test over everything: of each query the mean hits over the seeds, best minus
    paper (`intervals.difference_interval`).
    """
    of_best, of_paper = (np.mean([tried.hits for tried in each], axis=0) for each in (best, paper))
    return Comparison(
        n_places,
        len(of_best),
        tuple(seeds),
        _repeated(best),
        _repeated(paper),
        difference_interval(of_best, of_paper),
        tuple(mcnemar_exact(b.sure_hits, p.sure_hits) for b, p in zip(best, paper, strict=True)),
    )


def _repeated(tried: Sequence[Tried]) -> Repeated:
    return Repeated(tuple(each.recall_at_1 for each in tried), tuple(each.diverged for each in tried))
