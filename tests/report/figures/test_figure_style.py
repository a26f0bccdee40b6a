"""Figures read in grey, have the asked width, and are the same bytes for the same data."""

import itertools

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from vprbench.errors import BadInput
from vprbench.report.figures.style import (
    SINGLE_MM,
    Drawing,
    choose_looks,
    new_figure,
    scale_log,
    use_style,
    write_figure,
)
from vprbench.text import format_three_digits

PAPER = ["SAD", "NetVLAD", "GCL", "VPRSNN", "VPRTempo"]


def lightness(colour):
    """Return CIE L*, 0 to 100, of an sRGB colour."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return 116 * float(np.cbrt(np.dot(linear, [0.2126, 0.7152, 0.0722]))) - 16


@use_style
def drawing():
    figure, (axes,) = new_figure(SINGLE_MM, 60)
    axes.plot([1, 2, 3], [4, 6, 5], label="ünïcode")
    axes.bar([1, 2], [1, 2], hatch="//")
    axes.set(xlabel="Places", ylabel="Recall")
    axes.legend()
    return Drawing(figure, "Three points of a made-up method, with “quotes”.")


def test_any_two_methods_of_a_figure_look_different_and_those_of_the_paper_the_same_everywhere():
    rows = [*choose_looks(PAPER).values()]
    assert min(abs(lightness(a.colour) - lightness(b.colour)) for a, b in itertools.pairwise(rows)) > 12
    many = [*choose_looks([f"method {i}" for i in range(360)]).values()]
    assert len({(look.colour, look.marker, look.dash) for look in many}) == 360
    for part in ("colour", "marker", "dash", "hatch"):
        assert len({getattr(look, part) for look in many[:8]}) == 8
        assert len({getattr(look, part) for look in rows}) == len(PAPER)
    assert choose_looks(["mixvpr", "VPRTempo"])["VPRTempo"] == choose_looks(PAPER)["VPRTempo"]
    assert choose_looks([*PAPER, "cosplace", "mixvpr"])["mixvpr"] == choose_looks(["cosplace", "mixvpr"])["mixvpr"]


@pytest.mark.extended
def test_a_figure_has_its_width_and_the_same_bytes_whatever_a_reader_set_and_a_file_in_the_way_is_named(tmp_path):
    paths = write_figure(drawing(), tmp_path / "new" / "folder", "three")
    assert sorted((tmp_path / "new" / "folder").iterdir()) == list(paths)
    pdf, picture = (path.read_bytes() for path in paths)
    assert b"Date" not in pdf
    assert b"tIME" not in picture
    with Image.open(paths[1]) as image:
        assert image.width == pytest.approx(88 / 25.4 * 300, abs=1)
        assert image.info["Description"] == drawing().caption
    box = pdf.split(b"/MediaBox [")[1].split(b"]")[0].split()
    assert float(box[2]) == pytest.approx(88 / 25.4 * 72, abs=1)
    settings = dict(matplotlib.rcParams)
    with matplotlib.rc_context({"font.size": 20, "axes.facecolor": "black", "savefig.dpi": 50}):
        again = write_figure(drawing(), tmp_path, "three")
    assert [path.read_bytes() for path in again] == [pdf, picture]
    assert dict(matplotlib.rcParams) == settings
    there = tmp_path / "there"
    (there / "three.pdf").mkdir(parents=True)
    (there / "file").write_text("in the way")
    for folder in (there, there / "file"):
        with pytest.raises(BadInput, match=rf"three .*{folder.name}"):
            write_figure(drawing(), folder, "three")
    assert sorted(path.name for path in there.iterdir()) == ["file", "three.pdf"]


def test_numbers_are_written_to_three_digits_without_powers_of_ten_on_an_axis_that_holds_all_values():
    numbers = {15120: "15,120", 353: "353", 99.96: "100", 0.5: "0.5", 1.666: "1.67", 0.00123: "0.00123", 20: "20"}
    assert {value: format_three_digits(value) for value in numbers} == numbers
    for values in ([0.01, 3e6], [3.0, 3.1], [0.02, 0.9]):
        figure, (axes,) = new_figure(SINGLE_MM, 60)
        scale_log(axes, "x", values)
        figure.draw_without_rendering()
        low, high = axes.get_xlim()
        assert low < min(values) <= max(values) < high
        assert sum(low <= tick <= high for tick in axes.xaxis.get_majorticklocs()) >= 2
