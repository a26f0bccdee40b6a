"""The corruptions of query frames by their names: kind and strength, as in `shift-1`, and their descriptions."""

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
    unit: str  # around an amount
    words: str  # the change of query frames, around amounts with their unit

    def short(self, strengths: Sequence[int]) -> str:
        """Return the amounts of these strengths with their unit."""
        return self.unit.format("/".join(f"{self.amounts[each - 1]:g}" for each in strengths))

    def describe(self, strengths: Sequence[int]) -> str:
        """Return the change of query frames in words."""
        return self.words.format(self.short(strengths).replace("/", ", "))


KINDS = {
    "shift": Kind((1, 4, 8), "{} px", "moved left or right by {}, borders repeated"),
    "rotation": Kind((2, 5, 10), "{}°", "turned left or right by {}, borders repeated"),
    "brightness": Kind((0.5, 1, 2), "{} EV", "brighter or darker by {}: levels times 2 to that power"),
    "blur": Kind((1, 2, 4), "{} %", "blurred by a Gaussian whose deviation is {} of their width"),
    "noise": Kind((5, 10, 20), "±{}", "with Gaussian noise of {} levels in each pixel and channel"),
    "occlusion": Kind((10, 25, 50), "{} %", "with {} of their area hidden by a grey rectangle anywhere"),
    "resolution": Kind((2, 4, 8), "1:{}", "reduced {} and enlarged again"),
}


@dataclass(frozen=True)
class Corruption:
    """A change of the query frames of a run."""

    kind: str
    strength: int  # 1 to 3
    seed: int = 0  # of the direction, place or noise of each frame

    @property
    def name(self) -> str:
        """Its name in the option `corruption`."""
        return f"{self.kind}-{self.strength}" + (f"-{self.seed}" if self.seed else "")

    @property
    def amount(self) -> float:
        """How much, in the unit of the kind."""
        return KINDS[self.kind].amounts[self.strength - 1]

    @property
    def short(self) -> str:
        """The amount with its unit."""
        return KINDS[self.kind].short([self.strength])

    def protocol(self) -> str:
        """Return its entry in the protocol of a run."""
        return f"{self.name} (queries {KINDS[self.kind].describe([self.strength])}; seed {self.seed})"


def parse_corruption(name: str) -> Corruption:
    """Return the corruption of a name; raises BadInput for an unknown name."""
    parts = re.fullmatch(r"([a-z_]+)-([1-3])(?:-(\d{1,9}))?", name)
    if parts is None or parts[1] not in KINDS:
        kind = name.partition("-")[0]
        remedy = "give a strength from 1 to 3" if kind in KINDS else near(kind, KINDS)
        raise BadInput(f"corruption={name} is unknown: {remedy}, as in corruption=shift-1")
    return Corruption(parts[1], int(parts[2]), int(parts[3] or 0))


def parse_corruptions(names: Sequence[str]) -> tuple[Corruption, ...]:
    """Return the corruptions that are named, a kind for all its strengths, `all` for every kind, in the kinds' order.

    Raises BadInput for a name that is unknown, and for one corruption with two seeds.
    """
    wanted = {
        one
        for name in (KINDS if [*names] == ["all"] else names)
        for one in (
            [Corruption(name, strength) for strength in STRENGTHS] if name in KINDS else [parse_corruption(name)]
        )
    }
    if len({(one.kind, one.strength) for one in wanted}) < len(wanted):
        raise BadInput(f"corruptions={','.join(names)}: give each corruption once, with one seed")
    order = [*KINDS]
    return tuple(sorted(wanted, key=lambda one: (order.index(one.kind), one.strength)))
