"""Preprocessing images in memory, beside the readable engine."""

import pytest

from vprbench.api import OrientedEdges, PatchNormalisation

ENCODERS = {
    "patch normalisation to 28x28": lambda engine: PatchNormalisation("C", 28, 28, 7, engine=engine),
    "oriented edges": lambda engine: OrientedEdges(engine=engine),
}


@pytest.mark.parametrize("images", [1, 128])
@pytest.mark.parametrize("frame", [(32, 64), (360, 640)])
@pytest.mark.parametrize("into", ENCODERS)
def test_encode(into, frame, images, measure, route):
    shown = route(images, *frame).references(images)[0]
    ours, readable = (ENCODERS[into](engine) for engine in ("fused", "readable"))
    what = f"{frame[1]}x{frame[0]} into {into}, {images} together"
    measure(what, lambda: ours(shown), images, {"readable engine": lambda: readable(shown)})
