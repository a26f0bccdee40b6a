"""A report made up by hand: sixty places, fifty queries, and methods whose failures are known."""

import io

import numpy as np
from little import a_run, answered
from PIL import Image

from vprbench.report.page.page import Picture, Section, render_page
from vprbench.report.selection import MethodRuns
from vprbench.runs.notes import Note
from vprbench.runs.thumbnails import Thumbnails

N_PLACES, N_QUERIES = 60, 50
RIGHT, OTHERS = 0.5, 0.125  # scores of the right place, and of places that are not mistaken for it
UNANSWERABLE = 49
SHIFT = 7  # a mistaken place lies so many places behind the right one
SAD_WRONG = {3: 0.25, 10: 0.125, 11: 0.375, 20: 0.0, 30: 0.0625}  # by query, how far above the right place; 0: a tie
TEMPO_WRONG = {10: 0.125, 40: 0.25}


def right_place(query):
    return query + 5


def mistaken_place(query):
    return (right_place(query) + SHIFT) % N_PLACES


def journey_run(wrong, seed=0, **changes):
    scores = np.full((N_QUERIES, N_PLACES), OTHERS, np.float32)
    for query in range(N_QUERIES):
        scores[query, right_place(query)] = RIGHT
    for query, above in wrong.items():
        scores[query, mistaken_place(query)] = RIGHT + above
    positives = [[] if query == UNANSWERABLE else [right_place(query)] for query in range(N_QUERIES)]
    config = {**a_run().config, "seed": seed}
    return answered(scores, positives, **{"config": config, **changes})


def query_colour(query):
    return (250 - 4 * query, 40, 4 * query)


def place_colour(place):
    return (30, 4 * place, 200)


def drawn_frame(colour, size=(48, 27), kind="WEBP"):
    """Return a WebP of one colour, without loss."""
    Image.new("RGB", size, colour).save(written := io.BytesIO(), kind, lossless=True)
    return written.getvalue()


FIGURE = drawn_frame((225, 230, 240), (1200, 500), "PNG")


def journey_thumbnails(**changes):
    drawn = {
        "query_names": tuple(f"dusk/{query:05d}.png" for query in range(N_QUERIES)),
        "reference_names": tuple(f"noon/{place:05d}.png" for place in range(N_PLACES)),
        "examples": (),
        "queries": tuple(drawn_frame(query_colour(query)) for query in range(N_QUERIES)),
        "references": tuple(drawn_frame(place_colour(place)) for place in range(N_PLACES)),
    }
    return Thumbnails(**{**drawn, **changes})


def journey_section(title="Journey", thumbnails=None):
    sad = journey_run(SAD_WRONG, notes=(Note("noisy", "noisy: two carts passed"),))
    tempo = journey_run(TEMPO_WRONG, 0), journey_run({10: 0.125}, 1)
    return Section(title, (MethodRuns("SAD", (sad,)), MethodRuns("VPRTempo", tempo)), thumbnails)


TABLE = """<table class="results"><caption><b>Table II.</b> Measured here.</caption>
<tr><th scope="row">SAD</th><td class="measured"><span class="best">88.0</span> [76.2, 94.4]</td></tr></table>
"""


def made_up_page(sections=None):
    figure = Picture("speed", "How long a query takes, on Abacus 9.", FIGURE)
    given = [journey_section(thumbnails=journey_thumbnails())] if sections is None else sections
    return render_page(TABLE, [figure], given, made_from="Made from 3 stored runs.")
