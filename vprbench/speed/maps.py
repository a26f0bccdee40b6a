"""The benchmark of large maps: what each index costs on simulated descriptors, and what it finds of the best places."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import log, log10
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from vprbench.runs import machine
from vprbench.runs.document import document
from vprbench.speed.report import Failed, Planned, figures, hertz, measured, megabytes, publish
from vprbench.speed.searching import BEST, Case, searched
from vprbench.speed.settings import Options, option, quick
from vprbench.speed.simulated import AREA, SEEN_AGAIN, WITHIN, Simulated
from vprbench.storage.atomic import replace_text

EXACT = "exact"
INDEXES = ("binary", "rabitq", "sq8", "ivfpq", "hnsw", "binary_hnsw")
FOUND = (1, BEST)  # best places of which the share that an index finds too is told

_EXTRAPOLATED = (10**8, 10**9)  # places
_QUIET = 0.3  # cores that others may keep busy; of rows with more, times are no ground for larger maps
_FROM = 10_000  # places: times of smaller maps are those of a call
_ASKED = ["dimensions", "places", "index", "rerank", "threads"]  # a row replaces an earlier one that is alike in these
_DRAWN = ("dimensions", "places", "building_seconds", "query_seconds", "answering_bytes")

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Settings(Options):
    """Which maps to search by which indexes; raises BadInput if nothing would be measured."""

    places: list[int] = option([1000, 10_000, 100_000, 1_000_000], [300, 600], least=BEST)
    dimensions: list[int] = option([64, 512, 8448], [16])  # numbers of a descriptor
    indexes: list[str] = option(list(INDEXES), among=INDEXES)  # beside exact search, which they are compared with
    rerank: int = option(100, 20, least=0)  # best images of an index that are compared again, exactly
    queries: int = option(1000, 20)  # asked together, and one by one
    limit_minutes: float = option(10.0, least=0)  # of one index on one map
    most_gigabytes: float = option(10.0, least=0)  # of a map's descriptors; larger maps are left out
    folder: str | None = None  # where descriptors lie meanwhile; without it the system's temporary folder
    keep: bool = False  # leave them there for the next time

    def maps(self) -> Iterator[Simulated]:
        """Yield the maps, small ones first."""
        above = Path(self.folder or tempfile.gettempdir()).expanduser()
        for n_dimensions, n_places in product(sorted(self.dimensions), sorted(self.places)):
            yield Simulated(above, n_places, n_dimensions, self.seed)

    def file(self, ending: str) -> Path:
        """Return a file of results; those of quick=true replace no others."""
        return Path(self.results).expanduser() / f"maps{'-quick' * self.quick}.{ending}"


QUICK = quick(Settings)


@dataclass
class _Compared:
    """A map, and the best places of its queries once exact search has told them."""

    simulated: Simulated
    settings: Settings
    exactly: npt.NDArray[np.int64] | None = None

    def planned(self) -> Iterator[Planned]:
        for index in (EXACT, *self.settings.indexes):
            yield self.asked(index), partial(self.row, index)

    def asked(self, index: str) -> dict[str, str]:
        rerank = 0 if index == EXACT else self.settings.rerank
        where = {"dimensions": self.simulated.n_dimensions, "places": self.simulated.n_places}
        return {name: str(value) for name, value in {**where, "index": index, "rerank": rerank}.items()}

    def row(self, index: str) -> list[dict[str, Any]]:
        asked, settings = self.asked(index), self.settings
        vectors, queries = self.simulated.written(), self.simulated.queries(settings.queries)
        case = Case(vectors, index, int(asked["rerank"]), queries, settings.minimum_seconds)
        told = searched(case, 60 * settings.limit_minutes)
        found = told.pop("found")
        if index == EXACT:
            self.exactly = found
        shares = {} if self.exactly is None else {f"found_at_{n}": share_found(found, self.exactly, n) for n in FOUND}
        return [{**asked, **told, **shares}]


def measure(settings: Settings) -> bool:
    """Measure each index on each map, and write each row at once; returns whether all could be measured.

    Rows of other maps, indexes and numbers of threads that the file of results holds stay in it.
    """
    surroundings = machine.capture("cpu", settings.threads or len(machine.cores()))
    about = {"queries": settings.queries, "threads": surroundings["threads"]}
    about["machine"] = " ".join(machine.machine_lines(surroundings))
    complete = True
    for simulated in settings.maps():
        compared = _Compared(simulated, settings)
        try:
            for row in _rows(compared):
                failed = isinstance(row, Failed)
                complete &= not failed
                keep(settings.file("csv"), {**(row.row() if failed else row), **about})
        finally:
            if not settings.keep:
                simulated.remove()
    return complete


def _rows(compared: _Compared) -> Iterator[Any]:
    """Yield what is measured on a map, or that it is left out."""
    gigabytes, most = compared.simulated.n_bytes / 1e9, compared.settings.most_gigabytes
    if gigabytes <= most:
        yield from measured("maps", compared.planned())
    else:
        reason = f"left out: its descriptors take {figures(gigabytes)} GB, most_gigabytes={most:g}"
        yield {**compared.asked(EXACT), "index": "all", "failed": reason}


def keep(path: Path, row: Row) -> None:
    """Add a row to a file, in the place of an earlier one of the same map, index and number of threads."""
    whole = pd.DataFrame(
        [*stored(path), {**row, **{name: int(row[name]) for name in ("dimensions", "places", "rerank")}}]
    )
    kept = whole.drop_duplicates(_ASKED, keep="last").sort_values(_ASKED)
    replace_text(path, str(kept.to_csv(index=False, lineterminator="\n")))


def stored(path: Path) -> list[Row]:
    """Return the rows of a file; what a row lacks is None."""
    if not path.exists():
        return []
    return [
        {str(name): None if pd.isna(value) else value for name, value in row.items()}
        for row in pd.read_csv(path).to_dict("records")
    ]


def share_found(found: npt.NDArray[np.int64], exactly: npt.NDArray[np.int64], n: int) -> float:
    """Return how many of the `n` best places of exact search are among `n` found ones, (n_queries, >= n) each."""
    return float((exactly[:, :n, None] == found[:, None, :n]).any(2).mean())


def write(settings: Settings) -> None:
    """Draw all stored rows, and print them as Markdown, which stands in maps.md beside them."""
    from vprbench.paper.figures import maps as figure
    from vprbench.paper.figures import style

    rows = [row for row in stored(settings.file("csv")) if not row.get("failed")]
    if rows:
        drawn = figure.maps([figure.MapCost(_name(row), *(row[name] for name in _DRAWN)) for row in rows])
        style.write(drawn, settings.file("csv").parent / "figures", settings.file("csv").stem)
    publish(
        settings.file("md").parent, {settings.file("md").name: to_text(stored(settings.file("csv")), settings.quick)}
    )


def to_text(rows: Sequence[Row], quick: bool = False) -> str:
    """Return rows as Markdown, with what they let expect of larger maps."""
    there = [row for row in rows if not row.get("failed")]
    exact = {_where(row): row for row in there if row["index"] == EXACT}
    known = {_where(row) for row in there}
    failures = [row for row in rows if row.get("failed") and (row["index"] != "all" or _where(row) not in known)]
    libraries = [row["libraries_bytes"] for row in there if row["libraries_bytes"] is not None]
    return document(
        Path(__file__).with_name("maps.md.j2"),
        quick=quick,
        measured=[_shown(row, exact.get(_where(row))) for row in there],
        failures=[{**_asked(row), "reason": row["failed"]} for row in failures],
        grown=list(_grown(there)),
        libraries=megabytes(max(libraries)) if libraries else "?",
        machines=list(dict.fromkeys(row["machine"] for row in rows)),
        **{
            "AREA": AREA,
            "WITHIN": WITHIN,
            "SEEN_AGAIN": SEEN_AGAIN,
            "BEST": BEST,
            "FROM": f"{_FROM:,}",
            "QUIET": _QUIET,
        },
    )


def _where(row: Row) -> tuple[int, int, int]:
    return row["dimensions"], row["places"], row["threads"]


def _name(row: Row) -> str:
    return f"{row['index']} + rerank {row['rerank']}" if row["rerank"] else str(row["index"])


def _asked(row: Row) -> dict[str, str]:
    threads = f"{row['threads']}"
    return {
        "numbers": f"{row['dimensions']:,}",
        "places": f"{row['places']:,}",
        "threads": threads,
        "index": _name(row),
    }


def _shown(row: Row, exact: Row | None) -> dict[str, str]:
    memory = [row[f"{stage}_bytes"] for stage in ("building", "answering")]
    shares = [row.get(f"found_at_{n}") for n in FOUND]
    return {
        **_asked(row),
        "build s": figures(row["building_seconds"]),
        "index B": f"{row['bytes_per_place']:,.0f}",
        "memory MB": " / ".join("?" if each is None else megabytes(each) for each in memory),
        "Hz": hertz(1 / row["query_seconds"]),
        "x exact": _faster(row, exact),
        "Hz together": f"{hertz(1 / row['batch_seconds'])} ({row['queries']:,})",
        "found %": " / ".join("?" if share is None else f"{100 * share:.1f}" for share in shares),
        "others": f"{row['others']:.1f}",
    }


def _faster(row: Row, exact: Row | None) -> str:
    """Return how many times as fast as exact search an index is, about so if others worked beside one of the two."""
    if exact is None:
        return "?"
    disturbed = max(row["others"], exact["others"]) > _QUIET
    return ("about " if disturbed else "") + figures(exact["query_seconds"] / row["query_seconds"])


def _grown(rows: Sequence[Row]) -> Iterator[dict[str, str]]:
    """Yield what the two largest maps of each index let expect of far larger ones."""
    alike: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if row["places"] >= _FROM and row["others"] <= _QUIET:
            alike.setdefault((row["dimensions"], row["threads"], _name(row)), []).append(row)
    for sizes in alike.values():
        if len(sizes) < 2:
            continue
        *_, smaller, larger = sorted(sizes, key=lambda row: int(row["places"]))
        for n in _EXTRAPOLATED:
            times = {}
            for name, of in (("build h", "building_seconds"), ("query s", "query_seconds")):
                power = log(larger[of] / smaller[of]) / log(larger["places"] / smaller["places"])
                seconds = larger[of] * (n / larger["places"]) ** power
                times[name] = f"{figures(seconds / (3600 if name == 'build h' else 1))} (b {power:.2f})"
            yield {
                **{**_asked(larger), "places": f"10^{round(log10(n))}"},
                "from": f"{smaller['places']:,} and {larger['places']:,}",
                "index GB": figures(larger["bytes_per_place"] * n / 1e9),
                "vectors GB": figures(4 * larger["dimensions"] * n / 1e9),
                **times,
            }
