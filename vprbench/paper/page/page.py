"""The report: one HTML page that holds everything it shows and asks no network for anything."""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from vprbench.paper.page import words
from vprbench.paper.page.columns import format_place_ranges, list_columns, list_places_shown
from vprbench.paper.selection import Series
from vprbench.paper.table.quantities import TRAINING_TIME
from vprbench.progress import report
from vprbench.runs.query_results import Answers, judge_answers, order_by_interest
from vprbench.runs.recall_intervals import METHOD
from vprbench.runs.record import Run
from vprbench.runs.thumbnails import Thumbnails, choose_frames

TITLE = "Visual place recognition, measured"
MOST_FRAMES = 6000  # of a page, about 1.3 kB each

_FOLDER = Path(__file__).parent
_FRAMES_MISSING = "The frames of this dataset are not stored, so names stand in their places."
_SOME_MISSING = "{} of {} frames are shown; names stand in the places of the others."


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class Section:
    """The runs of one dataset and protocol, with its frames if they are stored."""

    title: str
    series: tuple[Series, ...]
    thumbnails: Thumbnails | None


@dataclass(frozen=True)
class _Frames:
    """The frames of a section that are shown, as WebP: of each query, and of some places by their number."""

    queries: tuple[bytes, ...] = ()  # empty: not shown
    places: Mapping[int, bytes] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of frames that are shown."""
        return sum(1 for frame in self.queries if frame) + len(self.places)


def page(
    table_html: str,
    pictures: Sequence[Picture],
    sections: Sequence[Section],
    title: str = TITLE,
    made_from: str = "",
    measured: Sequence[tuple[str, Series]] = (),
    absent: Sequence[str] = (),
) -> str:
    """Return the page: findings, queries one by one, table, figures, protocol, machines and notes.

    `table_html` is a fragment that is escaped already; `made_from` is a sentence that stands below the title.
    `measured` are the series behind the table on every device, with the titles of their sections: machines and notes
    are of them, or where there are none of the sections' own. `absent` says of each figure that is not drawn why.
    At most `MOST_FRAMES` frames are shown, as many of each section; queries that a run answered wrong come first.
    Raises ValueError where the runs of a section are not of the same images.
    """
    measured = measured or [(section.title, series) for section in sections for series in section.series]
    sections = [section for section in sections if section.series]
    answers = [_judged(section) for section in sections]
    most = MOST_FRAMES // max(1, len(sections))
    frames = [_frames(*shown, most) for shown in zip(sections, answers, strict=True)]
    script_data = [_script_data(*shown) for shown in zip(sections, answers, frames, strict=True)]
    facts = {
        "title": title,
        "made_from": made_from,
        "table": Markup(table_html),
        "pictures": [{"name": one.name, "caption": one.caption, "png": _base64(one.png)} for one in pictures],
        "absent": absent,
        "sections": [_facts(one, judged_runs) for one, judged_runs in zip(sections, answers, strict=True)],
        "interval_method": METHOD,
        "training_time": TRAINING_TIME,
        "machines": words.list_machines(series for _, series in measured),
        "notes": words.list_run_notes(measured),
        "judged": any(run.is_judged for section in sections for _, run in _named(section)),
    }
    return _rendered(facts, script_data, frames)


def _facts(section: Section, answers: Mapping[str, Answers]) -> dict[str, Any]:
    """Return what stands of a section in the page's text."""
    return {
        "title": section.title,
        "findings": words.list_findings(section.series, answers.values()),
        "protocol": words.list_protocol([run for _, run in _named(section)]),
    }


def _named(section: Section) -> list[tuple[str, Run]]:
    return [(words.name_run(series, run), run) for series in section.series for run in series.runs]


def _judged(section: Section) -> dict[str, Answers]:
    """Return the answers of each run of a section, by its name; raises ValueError for runs of several datasets."""
    named = _named(section)
    if len({run.fingerprint for _, run in named}) > 1:
        raise ValueError(f"the runs of {section.title} are of different images: a section shows one dataset")
    answers = {}
    for number, (name, run) in enumerate(named):
        report(f"judging answers, {section.title}", number / len(named))
        answers[name] = judge_answers(run)
    return answers


def _script_data(section: Section, answers: Mapping[str, Answers], frames: _Frames) -> dict[str, Any]:
    """Return what the page's script reads of a section."""
    runs, kept = [run for _, run in _named(section)], section.thumbnails
    run = runs[0]
    shown = list_places_shown(answers.values())
    place_names = None if kept is None else {place: kept.reference_names[place] for place in shown}
    return {
        "title": section.title,
        "judged": run.is_judged,
        "nPlaces": run.outcome.n_places,
        "nQueries": len(run.outcome),
        "queryNames": kept and kept.query_names,
        "placeNames": place_names,
        "firstReferences": words.describe_first_references(runs, place_names.values()) if place_names else "",
        "rightPlaces": [format_place_ranges(right) for right in run.positives],
        "framesMissing": _missing(kept, frames, len(run.outcome) + len(shown)),
        "runs": [{"name": name, **list_columns(one)} for name, one in answers.items()],
    }


def _missing(kept: Thumbnails | None, frames: _Frames, wanted: int) -> str:
    """Return the sentence on frames that are not shown; empty if all that the page speaks of are."""
    if kept is None:
        return _FRAMES_MISSING
    return "" if len(frames) == wanted else _SOME_MISSING.format(len(frames), wanted)


def _frames(section: Section, answers: Mapping[str, Answers], most: int) -> _Frames:
    """Return the frames of a section that the page shows, `most` at most."""
    kept = section.thumbnails
    if kept is None:
        return _Frames()
    in_turn = zip(*map(order_by_interest, answers.values()), strict=True)  # of each run a query
    queries, places = choose_frames(itertools.chain.from_iterable(in_turn), most)
    n_queries = len(section.series[0].runs[0].outcome)
    return _Frames(
        tuple(kept.queries[query] if query in queries else b"" for query in range(n_queries)),
        {place: frame for place in sorted(places) if (frame := kept.references[place])},
    )


def _rendered(facts: Mapping[str, Any], script_data: Sequence[Mapping[str, Any]], frames: Sequence[_Frames]) -> str:
    templates = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style, script = ((_FOLDER / name).read_text(encoding="utf-8") for name in ("style.css", "report.js"))
    text = templates.get_template("template.html").render(
        **facts,
        style=Markup(style),
        script=Markup(script),
        style_hash=_hash(style),
        script_hash=_hash(script),
        answers=_json(script_data),
        frames=[
            _json(
                {
                    "queries": [_base64(frame) for frame in one.queries],
                    "places": {place: _base64(frame) for place, frame in one.places.items()},
                }
            )
            for one in frames
        ],
    )
    return text.encode("utf-8", "replace").decode()  # a file name may hold what is no text


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _json(content: Any) -> Markup:
    """Return plain values as JSON that cannot end the script element around it."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def _hash(text: str) -> str:
    """Return what a content security policy calls a script or a style by."""
    return f"sha256-{_base64(hashlib.sha256(text.encode()).digest())}"
