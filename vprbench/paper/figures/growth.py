"""Time against the number of places, with the laws of growth fitted to it: Figure 2C of the paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from vprbench.errors import BadInput
from vprbench.metrics.growth import LAWS, Comparison, Law, compare
from vprbench.paper.figures.log_axis import plain_log
from vprbench.paper.figures.measured_on import caption, listed, machine_sentence
from vprbench.paper.figures.style import DOUBLE_MM, GREY, Dash, Drawn, Look, looks, new, styled
from vprbench.paper.growth import GrowthSamples, Sample

_CLAIMS: dict[str, tuple[Law, Law]] = {"VPRTempo": ("linear", "logarithmic")}  # by the paper: training, query
_DASHES: dict[Law, Dash] = {"constant": (0, (1, 2)), "logarithmic": (0, (4, 2)), "linear": (0, ())}
_ORDER: dict[Law, str] = {"constant": "O(1)", "logarithmic": "O(log n)", "linear": "O(n)"}
_MS = 1e3  # milliseconds of a second
_LARGE, _SMALL = 4.0, 2.4  # markers, in points: of what the laws are fitted to, and of encode and match beside it


@styled
def growth(rows: Sequence[GrowthSamples]) -> Drawn:
    """Draw training time (left) and the time of a query (right) against the number of places, with fitted laws.

    One row shows all laws, several rows the best law of each. Raises BadInput where there is no row.
    """
    if not rows:
        raise BadInput("no run with different numbers of places is stored: there is no growth to draw")
    figure, (left, right) = new(DOUBLE_MM, 92, 1, 2)
    looked = looks([row.name for row in rows])
    said: list[str] = []
    fitted = False
    for row in rows:
        look, name = looked[row.name], "" if len(rows) == 1 else f"{row.name}: "
        stage = "encode and match" if row.boundary is None else f"{row.boundary} alone"
        claimed = _CLAIMS.get(row.name, (None, None))
        training, query, total = (_compared(samples) for samples in (row.training, row.query, row.total))
        _draw_points(left, row.training, 1, look, f"{name}training{_power(training)}", _LARGE)
        _draw_laws(left, row.training, training, 1, look, name)
        _draw_points(right, row.query, _MS, look, f"{name}{stage}{_power(query)}", _LARGE)
        _draw_points(right, row.total, _MS, look, f"{name}encode and match{_power(total)}", _SMALL)
        _draw_laws(right, row.query, query, _MS, look, name)
        fitted = fitted or not (training is None and query is None)
        said.append(_seen(f"the training time of {row.name}", row.training, training, claimed[0]))
        said.append(_seen(f"the query time of {row.name} ({stage})", row.query, query, claimed[1]))
    left.set(xlabel="Places", ylabel="Training time (s)", title="Training")
    right.set(xlabel="Places", ylabel="Time of a query (ms)", title="Query")
    _finish(left, [sample for row in rows for sample in row.training], 1)
    _finish(right, [sample for row in rows for sample in (*row.query, *row.total)], _MS)
    return Drawn(figure, _caption(rows, said, fitted))


def _compared(samples: Sequence[Sample]) -> Comparison | None:
    """Compare the laws; None where the samples are too few to tell them apart."""
    try:
        return compare([sample.n_places for sample in samples], [sample.seconds for sample in samples])
    except BadInput:
        return None


def _power(comparison: Comparison | None) -> str:
    if comparison is None:
        return ""
    exponent = comparison.exponent
    return f", exponent {exponent.value:.2f} [{exponent.low:.2f}, {exponent.high:.2f}]"


def _draw_points(axes: Axes, samples: Sequence[Sample], unit: float, look: Look, label: str, size: float) -> None:
    """Draw times with their intervals; the disturbed ones are hollow."""
    for disturbed in (False, True):
        drawn = [sample for sample in samples if sample.disturbed is disturbed]
        if not drawn:
            continue
        ends = [[s.seconds - (s.low or s.seconds), (s.high or s.seconds) - s.seconds] for s in drawn]
        axes.errorbar(
            [sample.n_places for sample in drawn],
            [unit * sample.seconds for sample in drawn],
            unit * np.array(ends).T,
            color=look.colour,
            marker=look.marker,
            markersize=size,
            markerfacecolor="white" if disturbed else look.colour,
            linestyle="none",
            label=label,
            zorder=3,
        )
        label = ""  # once in the legend


def _draw_laws(
    axes: Axes, samples: Sequence[Sample], comparison: Comparison | None, unit: float, look: Look, name: str
) -> None:
    """Draw the best law, and thinly the others where the row is alone and so has no name in front of its labels."""
    if comparison is None:
        return
    fewest, *_, most = sorted(sample.n_places for sample in samples)
    places = np.geomspace(fewest, most, 200)
    for law in sorted(LAWS, key=lambda law: comparison.fits[law].aicc):
        best = law == comparison.best
        if best or not name:
            verdict = "lowest AICc" if best else f"AICc higher by {comparison.differences[law]:.1f}"
            axes.plot(
                places,
                unit * comparison.fits[law].at(places),
                color=look.colour if best else GREY,
                linestyle=_DASHES[law],
                linewidth=1.8 if best else 0.9,
                label=f"{name}{law}, {verdict}",
                zorder=2 if best else 1,
            )


def _finish(axes: Axes, samples: Sequence[Sample], unit: float) -> None:
    if not samples:
        axes.text(0.5, 0.5, "nothing was trained", transform=axes.transAxes, ha="center", color=GREY, style="italic")
        axes.set(xticks=[], yticks=[])
        return
    plain_log(axes, "x", [sample.n_places for sample in samples])
    plain_log(axes, "y", [unit * sample.seconds for sample in samples])
    axes.grid(True)
    handles, labels = axes.get_legend_handles_labels()
    points_first = sorted(range(len(handles)), key=lambda i: isinstance(handles[i], Line2D))
    axes.legend(
        [handles[i] for i in points_first],
        [labels[i] for i in points_first],
        loc="upper left",
        bbox_to_anchor=(-0.02, -0.2),
        borderaxespad=0,
    )


def _seen(subject: str, samples: Sequence[Sample], comparison: Comparison | None, claimed: Law | None) -> str:
    """Say which law describes the times, beside what the paper claims of them."""
    if not samples:
        return f"There is no {subject.removeprefix('the ')}."
    subject = subject[0].upper() + subject[1:]
    if comparison is None:
        return f"{subject} was measured at too few numbers of places to tell laws apart."
    laws = comparison.supported
    if claimed and laws == (claimed,):
        return f"{subject} is described best by a {claimed} law, {_ORDER[claimed]}, as claimed."
    if len(laws) > 1 and claimed in (None, *laws):
        possible = f"; {_ORDER[claimed]} is possible, not shown" if claimed else ""
        return f"{subject} does not separate these laws: {listed(laws)}{possible}."
    best = f"{subject} is described best by a {' or '.join(laws)} law, {' or '.join(_ORDER[law] for law in laws)}"
    if claimed is None:
        return f"{best}."
    higher = f"{comparison.differences[claimed]:.1f}"
    return f"{best}, and not by the claimed {_ORDER[claimed]}, whose AICc is higher by {higher}."


def _claims(rows: Sequence[GrowthSamples]) -> str:
    """Say what the paper claims of the rows that it claims something of."""
    claims = [(row.name, *_CLAIMS[row.name]) for row in rows if row.name in _CLAIMS]
    return " ".join(
        f"The paper claims of {name} {_ORDER[training]} for training and {_ORDER[query]} for a query."
        for name, training, query in claims
    )


def _disturbed(rows: Sequence[GrowthSamples]) -> str:
    """Name the sizes whose times were disturbed; nothing where there are none."""
    found = {row.name: sorted({s.n_places for s in (*row.training, *row.query) if s.disturbed}) for row in rows}
    places = [f"{name} at {listed(f'{n:,}' for n in sizes)} places" for name, sizes in found.items() if sizes]
    if not places:
        return ""
    return f"Hollow points: other work disturbed the machine, or laps were too few, for {'; '.join(places)}."


def _caption(rows: Sequence[GrowthSamples], said: Sequence[str], fitted: bool) -> str:
    runs = [run for row in rows for run in row.runs]
    sizes = sorted({run.outcome.n_places for run in runs})
    shown = "thin lines are the other laws" if len(rows) == 1 else "of each row the best law alone is drawn"
    laws = (
        "Constant, logarithmic and linear laws that do not fall are fitted by least squares on the logarithm of time; "
        f"the thick line has the lowest AICc, {shown}. An exponent is that of a power law over these sizes, with its "
        "95 % interval."
    )
    return caption(
        f"Time against the number of places on {listed(run.dataset for run in runs)}: {len(sizes)} maps of "
        f"{sizes[0]:,} to {sizes[-1]:,} places; both axes are logarithmic.",
        "Left: training without waiting for the images to be read, one point a run.",
        "Right: one query at a time from memory; a point is the median, its bar the 95 % interval of the median"
        f"{'; small points are encode and match' if any(row.total for row in rows) else ''}.",
        _disturbed(rows),
        "A point is a seed; laws and exponents are those of the median over the seeds of each size."
        if any(len({run.config["seed"] for run in row.runs}) > 1 for row in rows)
        else "",
        laws if fitted else "",
        _claims(rows),
        *said,
        machine_sentence(runs),
        *(sentence for row in rows for sentence in row.aside),
    )
