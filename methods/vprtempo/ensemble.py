"""Several VPRTempo networks of the same places, trained side by side from different seeds, with fused scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from vprbench.api import BadInput

from .method import VPRTempo


@dataclass
class VPRTempoEnsemble(VPRTempo):
    """The mean score of `members` networks, of the seeds `seed`, `seed` + 1 and so on (VPRTempo paper, future work).

    Each member is the network that VPRTempo trains from that seed. Under a linear query rule the ensemble is a
    single matrix and answers as fast as one network.
    """

    members: int = 5

    conformance_arguments: ClassVar[Mapping[str, Any]] = {**VPRTempo.conformance_arguments, "members": 2}
    stored_as: ClassVar[str] = "vprtempo_ensemble"

    def check(self) -> None:
        """Raise BadInput for arguments under which there is no network."""
        if self.members < 1:
            raise BadInput(f"method.members={self.members}: give at least 1 network")
        super().check()

    def _seeds(self) -> list[int]:
        return list(range(self.seed, self.seed + self.members))
