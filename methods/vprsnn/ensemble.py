"""Several VPRSNN networks of the same places, trained from different seeds, with summed scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from vprbench.api import BadInput

from .method import VPRSNN
from .model import Model


@dataclass
class VPRSNNEnsemble(VPRSNN):
    """The summed scores of VPRSNN networks of the seeds `seed` + `seeds`, as VPRSNN's authors combine them.

    `member_epochs` and `member_thresholds` are of each member; None: `epochs` and `hyperactive_threshold` of all.
    Published for Nordland (spring, fall, summer): epochs 70, 60, 60, 60, 70 and thresholds 80, 180, 140, 220, 60.
    """

    seeds: list[int] = field(default_factory=lambda: [0, 10, 20, 30, 40])
    member_epochs: list[int] | None = None
    member_thresholds: list[int] | None = None

    conformance_arguments: ClassVar[Mapping[str, Any]] = {**VPRSNN.conformance_arguments, "seeds": [0, 10]}
    stored_as: ClassVar[str] = "vprsnn_ensemble"

    def _members(self) -> list[tuple[Model, int | None]]:
        epochs = self.member_epochs or [self.epochs] * len(self.seeds)
        thresholds: Sequence[int | None] = self.member_thresholds or [self.hyperactive_threshold] * len(self.seeds)
        return [
            (Model.of(self, seed=self.seed + seed, epochs=times), threshold)
            for seed, times, threshold in zip(self.seeds, epochs, thresholds, strict=True)
        ]

    def check(self) -> None:
        """Raise BadInput for arguments under which there is no network."""
        super().check()
        if self.published_weights is not None:
            raise BadInput("method.published_weights: the members of an ensemble would all be the same; use vprsnn")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) + self.seed < 0:
            raise BadInput(f"method.seeds={[*self.seeds]}: give at least one, 0 or more, each once")
        for name, values, least in (
            ("member_epochs", self.member_epochs, 1),
            ("member_thresholds", self.member_thresholds, 0),
        ):
            if values is not None and (len(values) != len(self.seeds) or min(values) < least):
                raise BadInput(f"method.{name}={[*values]}: give {least} or more for each of {len(self.seeds)} seeds")
