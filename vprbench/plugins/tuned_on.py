"""What a method's yaml says of the places on which its settings were chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True)
class TunedOn:
    """The places on which the settings of a method were chosen: the key `tuned_on` of its yaml."""

    dataset: str  # its name, as runs hold it
    places: str  # in words: the first 1000 places
    also_in: tuple[str, ...] = ()  # datasets that show these places under other names

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
