"""One run that is asked for: what is run on what, and under which conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.plugins import networks
from vprbench.run.descriptors import DescriptorCache
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
