"""The options of `search`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vprbench.errors import BadInput
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins.options import option

FEWEST_PLACES = 10  # of a stretch: below, a network whose training diverged is not seen
QUICK: Mapping[str, Any] = {"places": 20, "trials": 6}


@dataclass(frozen=True)
class Settings(ClusterOptions):
    """Where to search, and how long; raises BadInput if nothing would be tried."""

    places: int = option(500, "of the stretch that is searched")
    trials: int = option(200, "two thirds of them random, the rest on the grid")
    jobs: int | None = option(None, "processes of one thread each, at most; null: one for each core")
    dataset: str = option("synthetic", "a rendered one, or one with places that no result uses")
    root: str | None = option(None, "the folder of a recorded dataset")
    quick: bool = option(False, "true: tiny sizes, everything runs, nothing is found")
    seed: int = option(0, "of the random settings, and of each trial's training")
    results: str = option("results")

    def __post_init__(self) -> None:
        """Check that something will be tried."""
        super().__post_init__()
        if self.jobs is not None and self.is_distributed:
            raise BadInput("jobs= are processes of this machine: leave jobs= out")
        for name, least in (("places", FEWEST_PLACES), ("trials", 1), ("jobs", 1), ("seed", 0)):
            given = getattr(self, name)
            if given is not None and given < least:
                raise BadInput(f"{name}={given}: give at least {least}")
