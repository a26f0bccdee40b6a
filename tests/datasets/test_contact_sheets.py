"""The contact sheets of the documentation show what the datasets render today."""

import importlib.util
import sys

import cv2
import numpy as np
import pytest
from checkout import ROOT

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def sheets():
    spec = importlib.util.spec_from_file_location("make_contact_sheets", DOCS / "make_contact_sheets.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where a dataclass looks for its module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.mark.parametrize("name", ["synthetic", "street"])
def test_the_kept_sheet_shows_every_traverse_as_it_is_rendered_and_is_small_enough_for_a_page(sheets, name):
    dataset, blocks = sheets.SHEETS[name]
    defaults = dataset(places=10)
    assert {*defaults.protocol["references"], defaults.protocol["query"]} <= set(blocks[0].traverses)
    assert (DOCS / f"{name}.png").stat().st_size < 1_500_000
    kept = cv2.cvtColor(cv2.imread(str(DOCS / f"{name}.png")), cv2.COLOR_BGR2RGB)
    for number, block in enumerate(blocks):
        for row, traverse in enumerate(block.traverses):
            for column in (0, len(block.places) - 1):
                top, left = sheets.frame_corner(number, row, column, blocks)
                place = block.places[column]
                shown = dataset(places=place + 10, references=[traverse], query=traverse).references[place]
                assert np.array_equal(kept[top : top + 90, left : left + 160], shown), "run docs/make_contact_sheets.py"
