"""How long and how often to measure, and which measurements are as good as another."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from pydantic import ConfigDict, Field, with_config

from vprbench.errors import BadInput
from vprbench.metrics.bounds import Count, Flag, Positive, Seconds


@with_config(ConfigDict(extra="forbid", strict=False))
@dataclass(frozen=True)
class Protocol:
    """How long and how often to measure; a part of every record.

    A measurement ends when all three minima are met, or unfinished at `maximum_seconds`: it is then marked invalid.
    Source: the rules of MLPerf LoadGen (warm-up, minimum duration and count).
    """

    minimum_seconds: Seconds = 1.0
    minimum_queries: Positive = 64  # enough for a 90th percentile; 662 are for a 99th
    minimum_passes: Positive = 1  # over the sample of images
    maximum_seconds: Annotated[Seconds, Field(gt=0)] = 120.0
    sample: Positive = 256  # query images held decoded in memory, at most
    warmup_queries: Count = 50  # at most; fewer once the last ten differ by less than 10 %
    batch_sizes: Annotated[list[Positive], Field(min_length=1)] = field(default_factory=lambda: [1, 8, 32, 128])
    rates: Flag = True  # False: nothing is timed

    def __post_init__(self) -> None:
        """Check that a measurement can end."""
        if self.minimum_seconds > self.maximum_seconds:
            raise BadInput(
                f"timing.minimum_seconds={self.minimum_seconds}, timing.maximum_seconds={self.maximum_seconds}: the "
                "minimum cannot exceed the maximum"
            )

    def shortfalls(self, request: Protocol) -> list[str]:
        """Return the options in which this protocol measures less than `request`; none: it is enough.

        Any measurement answers `rates: false`.
        """
        if not request.rates:
            return []
        if not self.rates:
            return ["rates"]
        return [
            part.name for part in fields(self) if _measures_less(getattr(self, part.name), getattr(request, part.name))
        ]


def _measures_less(kept: Any, request: Any) -> bool:
    if isinstance(request, list):
        return not set(request) <= set(kept)
    return bool(kept < request)
