"""The places that a method's settings were chosen on, as its yaml declares them: `tuned_on`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

UNKNOWN = "unknown"
_STRETCHES = re.compile(r" *\d+ *- *\d+ *(, *\d+ *- *\d+ *)*")


@dataclass(frozen=True)
class TunedOn:
    """The places on which the settings of a method were chosen: the key `tuned_on` of its yaml."""

    dataset: str  # its name, as runs hold it
    places: str  # their numbers there, ends included: 0-999, or 0-99,200-299; in other words: which ones is not known
    also_in: dict[str, str] | tuple[str, ...] = ()  # other datasets that show them, with the numbers there, or alone

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}


def declared_places(given: Any, where: object) -> dict[str, Any]:
    """Return a declared `tuned_on` as plain values; raises BadInput that names the yaml or method."""
    if given is None:
        return {}
    from vprbench.plugins.checked import checked

    known: TunedOn = checked(f"{where}: tuned_on", given, TunedOn)
    named = known.also_in if isinstance(known.also_in, Mapping) else dict.fromkeys(known.also_in, UNKNOWN)
    return {**asdict(known), "also_in": dict(named)}


def stretches(places: str) -> list[tuple[int, int]] | None:
    """Return the first and the last number of each stretch of declared places; None: it does not say which."""
    if _STRETCHES.fullmatch(places) is None:
        return None
    found = [(int(first), int(last)) for first, last in re.findall(r"(\d+) *- *(\d+)", places)]
    return found if all(first <= last for first, last in found) else None
