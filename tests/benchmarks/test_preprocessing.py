"""Filtering images in memory, beside the readable twins."""

import pytest
import readable_encoders as readable

from vprbench.methods.parts.filters.oriented import OrientedEdges
from vprbench.methods.parts.filters.patches import PatchNormalisation

PATCHES, EDGES = PatchNormalisation("C", 28, 28, 7), OrientedEdges()
FILTERS = {
    "patch normalisation to 28x28": (PATCHES, lambda images: readable.encode_patches(PATCHES, images)),
    "oriented edges": (EDGES, lambda images: [readable.encode_edges(EDGES, image) for image in images]),
}


@pytest.mark.parametrize("images", [1, 128])
@pytest.mark.parametrize("frame", [(32, 64), (360, 640)])
@pytest.mark.parametrize("into", FILTERS)
def test_encode(into, frame, images, measure, route):
    shown = route(images, *frame).references(images)[0]
    ours, twin = FILTERS[into]
    what = f"{frame[1]}x{frame[0]} into {into}, {images} together"
    measure(what, lambda: ours(shown), images, {"readable twin": lambda: twin(shown)})
