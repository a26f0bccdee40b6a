"""One run that is asked for: what is run on what, and under which conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method, calibration
from vprbench.plugins import networks
from vprbench.run.descriptors import DescriptorCache
from vprbench.run.identity import Identity, code_hash
from vprbench.run.stopwatch import Protocol

_NO_FILES = networks.Files()


@dataclass(frozen=True)
class Request:
    """One run that is asked for."""

    name: str  # of the method
    method: Method
    dataset: Dataset
    config: Mapping[str, Any]  # method, dataset, seed, device, depth and what else was asked for, resolved
    fingerprint: str  # of the dataset
    protocol: Protocol
    threads: int
    files: networks.Files = _NO_FILES  # networks to load or to store
    cache: DescriptorCache | None = None  # for descriptors worth keeping

    def key(self) -> str:
        """Return the hash of all that can change the outcome of the run or the times it measures."""
        held_out = calibration(self.method, self.dataset)
        return Identity(
            method_class=type(self.method).__qualname__,
            code=code_hash(type(self.method)),
            config=self.config,
            dataset=self.dataset,
            images=self.fingerprint,
            held_out=None if held_out is None else held_out.fingerprint(),
            timing=self.protocol,
            threads=self.threads,
            network=self.files.sha256,
        ).key()
