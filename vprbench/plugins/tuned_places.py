"""The places that a method's settings were chosen on, as its yaml declares them: `tuned_on`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

UNKNOWN = "unknown"
_RANGES = re.compile(r" *\d+ *- *\d+ *(, *\d+ *- *\d+ *)*")


@dataclass(frozen=True)
class TunedOn:
    """The places on which the settings of a method were chosen: the key `tuned_on` of its yaml."""

    dataset: str  # its name, as runs hold it
    places: str  # their numbers there, ends included: 0-999, or 0-99,200-299; any other words: the numbers are unknown
    also_in: dict[str, str] | tuple[str, ...] = ()  # other datasets that show them, with or without the numbers there

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}


def parse_tuned_on(given: Any, where: object) -> dict[str, Any]:
    """Return a declared `tuned_on` as plain values; raises BadInput that names the yaml or method `where` it stands."""
    if given is None:
        return {}
    from vprbench.plugins.values import check_value

    tuned: TunedOn = check_value(f"{where}: tuned_on", given, TunedOn)
    also = tuned.also_in if isinstance(tuned.also_in, Mapping) else dict.fromkeys(tuned.also_in, UNKNOWN)
    return {**asdict(tuned), "also_in": dict(also)}


def parse_places(places: str) -> list[tuple[int, int]] | None:
    """Return the first and the last number of each range of declared places; None if they hold no numbers."""
    if _RANGES.fullmatch(places) is None:
        return None
    found = [(int(first), int(last)) for first, last in re.findall(r"(\d+) *- *(\d+)", places)]
    return found if all(first <= last for first, last in found) else None
