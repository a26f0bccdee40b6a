"""The options of `search`."""

from __future__ import annotations

from dataclasses import dataclass

from vprbench.errors import BadInput
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins.options import option

FEWEST_PLACES = 10  # of a stretch: below, a network whose training diverged is not seen


@dataclass(frozen=True)
class Settings(ClusterOptions):
    """Where to search, and how long; raises BadInput if nothing would be tried."""

    places: int = option(500, "of the stretch that is searched")
    trials: int = option(200, "two thirds of them random, the rest on the grid")
    workers: int | None = option(
        None, "processes of one thread each, null: one for each core; of cluster= the most jobs"
    )
    dataset: str = option("synthetic", "a rendered one, or one with places that no result uses")
    root: str | None = option(None, "the folder of a recorded dataset")
    seed: int = option(0, "of the random settings, and of each trial's training")
    results: str = option("results")

    def __post_init__(self) -> None:
        """Check that something will be tried."""
        super().__post_init__()
        for name, least in (("places", FEWEST_PLACES), ("trials", 1), ("seed", 0)):
            if (given := getattr(self, name)) < least:
                raise BadInput(f"{name}={given}: give at least {least}")
