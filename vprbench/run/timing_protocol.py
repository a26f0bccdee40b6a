"""How long and how often to measure, and which measurements are as good as another."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from vprbench.errors import BadInput


@dataclass(frozen=True)
class Protocol:
    """How long and how often to measure; a part of every record.

    A measurement ends when all three minima are met, or unfinished at `maximum_seconds`: it is then marked invalid.
    Source: the rules of MLPerf LoadGen (warm-up, minimum duration and count).
    """

    minimum_seconds: float = 1.0
    minimum_queries: int = 64  # enough for a 90th percentile; 662 are for a 99th
    minimum_passes: int = 1  # over the sample of images
    maximum_seconds: float = 120.0
    sample: int = 256  # query images held decoded in memory, at most
    warmup_queries: int = 50  # at most; fewer once the last ten differ by less than 10 %
    batch_sizes: list[int] = field(default_factory=lambda: [1, 8, 32, 128])
    total_seconds: float | None = None  # of all measurements together; None: no limit
    rates: bool = True  # False: nothing is timed

    def __post_init__(self) -> None:
        """Check that something will be measured."""
        if min(self.minimum_queries, self.minimum_passes, self.sample) < 1 or not self.batch_sizes:
            raise BadInput(
                f"timing.minimum_queries={self.minimum_queries}, timing.minimum_passes={self.minimum_passes}, "
                f"timing.sample={self.sample}: all have to be at least 1, and timing.batch_sizes not empty"
            )
        if min(self.batch_sizes) < 1 or not 0 <= self.minimum_seconds <= self.maximum_seconds > 0:
            raise BadInput(
                f"timing.batch_sizes={self.batch_sizes}, timing.minimum_seconds={self.minimum_seconds}, "
                f"timing.maximum_seconds={self.maximum_seconds}: batches hold at least one image, and the minimum "
                "cannot exceed the maximum"
            )
        if self.total_seconds is not None and not self.total_seconds > 0:
            raise BadInput(f"timing.total_seconds={self.total_seconds}: give more than 0, or null for no limit")

    def shortfalls(self, asked: Protocol) -> list[str]:
        """Return the options in which what it measured is less than what is asked for; none: it answers that.

        Whatever was measured answers `rates: false`.
        """
        if not asked.rates:
            return []
        if not self.rates:
            return ["rates"]
        return [part.name for part in fields(self) if _less(getattr(self, part.name), getattr(asked, part.name))]


def _less(kept: Any, asked: Any) -> bool:
    if isinstance(asked, list):
        return not set(asked) <= set(kept)
    return kept is not None and (asked is None or bool(kept < asked))  # None: no limit
