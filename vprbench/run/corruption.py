"""The corruptions of query frames by their names: kind and strength, as in `shift-1`, and what they are in words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from vprbench.errors import BadInput
from vprbench.text import near

STRENGTHS = (1, 2, 3)  # weak, medium, strong


@dataclass(frozen=True)
class Kind:
    """One way to spoil a frame, in three strengths."""

    amounts: tuple[float, float, float]
    short: str  # an amount with its unit
    words: str  # what is done to each query frame


KINDS = {
    "shift": Kind((1, 4, 8), "{:g} px", "moved left or right by {}, borders repeated"),
    "rotation": Kind((2, 5, 10), "{:g}°", "turned left or right by {}, borders repeated"),
    "brightness": Kind((0.5, 1, 2), "{:g} EV", "brighter or darker by {} (grey levels times 2 to that power)"),
    "blur": Kind((1, 2, 4), "{:g} %", "blurred by a Gaussian whose standard deviation is {} of the frame's width"),
    "noise": Kind((10, 25, 50), "±{:g}", "with Gaussian noise of {} grey levels in each pixel and channel"),
    "occlusion": Kind((10, 25, 50), "{:g} %", "with {} of the area hidden by a grey rectangle anywhere"),
    "resolution": Kind((2, 4, 8), "1/{:g}", "reduced to {} of the resolution and enlarged again"),
}


@dataclass(frozen=True)
class Corruption:
    """What is done to the query frames of a run."""

    kind: str
    strength: int  # 1 to 3
    seed: int = 0  # of what is drawn for each frame: direction, place, noise

    @property
    def name(self) -> str:
        """What it is asked for by."""
        return f"{self.kind}-{self.strength}" + (f"-{self.seed}" if self.seed else "")

    @property
    def amount(self) -> float:
        """How much, in the unit of the kind."""
        return KINDS[self.kind].amounts[self.strength - 1]

    @property
    def short(self) -> str:
        """The amount with its unit."""
        return KINDS[self.kind].short.format(self.amount)

    def protocol(self) -> str:
        """Return what stands of it in the protocol of a run."""
        return f"{self.name} (queries {KINDS[self.kind].words.format(self.short)}; seed {self.seed})"


def corruption(name: str) -> Corruption:
    """Return the corruption of a name; raises BadInput for one that there is not."""
    parts = re.fullmatch(r"([a-z_]+)-([1-3])(?:-(\d{1,9}))?", name)
    if parts is None or parts[1] not in KINDS:
        kind = name.partition("-")[0]
        told = "give a strength from 1 to 3" if kind in KINDS else near(kind, KINDS)
        raise BadInput(f"corruption={name} is unknown: {told}, as in corruption=shift-1")
    return Corruption(parts[1], int(parts[2]), int(parts[3] or 0))


def corruptions(names: Sequence[str]) -> tuple[Corruption, ...]:
    """Return the corruptions that are named, a kind for all its strengths, `all` for every kind, in the kinds' order.

    Raises BadInput for a name that is unknown, and for one corruption with two seeds.
    """
    wanted = {
        one
        for name in (KINDS if [*names] == ["all"] else names)
        for one in ([Corruption(name, strength) for strength in STRENGTHS] if name in KINDS else [corruption(name)])
    }
    if len({(one.kind, one.strength) for one in wanted}) < len(wanted):
        raise BadInput(f"corruptions={','.join(names)}: give each corruption once, with one seed")
    order = [*KINDS]
    return tuple(sorted(wanted, key=lambda one: (order.index(one.kind), one.strength)))
