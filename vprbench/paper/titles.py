"""What columns are called: their titles, and the protocol of a run in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from vprbench.paper.selection import Group
from vprbench.runs.record import Run


def title(group: Group, among: Sequence[Group]) -> str:
    """Return the title of a group's column; of several, with its protocol if that differs, or else its images."""
    planned = group.asked.planned
    versions = [other for other in among if other.asked.planned.name == planned.name and other.runs]
    if len(versions) < 2:
        return planned.title
    protocols = [_told(other.runs[0]) for other in versions]
    names = dict.fromkeys(n for p in protocols for n in p if not n.startswith(("sequence_", "filter_")))  # as of views
    differing = [name for name in names if any(p.get(name) != protocols[0].get(name) for p in protocols)]
    parts = [_words({name: p[name] for name in differing if name in p}) for p in protocols]
    mine = parts[next(i for i, other in enumerate(versions) if other is group)]
    images = "" if mine and parts.count(mine) == 1 else f"images {group.runs[0].fingerprint[:8]}"
    return ", ".join(filter(None, [planned.title, mine, images]))


def describe_protocol(run: Run) -> str:
    """Return what a run's dataset selected and how, without the numbers of its places and queries."""
    return _words({name: value for name, value in _told(run).items() if name not in ("places", "query_places")})


def _told(run: Run) -> dict[str, Any]:
    """Return the protocol of a run without counts that follow from the rest of it."""
    follows = {"reference_places"} | ({"held_out_places"} if "first_query_place" in run.protocol else set())
    return {name: value for name, value in run.protocol.items() if name not in follows}


def _words(protocol: Mapping[str, Any]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {_word(value)}" for name, value in protocol.items())


def _word(value: Any) -> str:
    if isinstance(value, Mapping):
        return "+".join(f"{inner} in {name}" for name, inner in value.items())
    return "+".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
