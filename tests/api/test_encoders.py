"""What all encoders of frames share: patch normalisation, Gabor filters and oriented edges."""

import math

import numpy as np
import pytest
import torch
from preprocess_frames import smooth_frame

from vprbench.api.gabor import GaborBank
from vprbench.api.images import Images
from vprbench.api.oriented import OrientedEdges
from vprbench.api.preprocess import PatchNormalisation
from vprbench.errors import BadInput

ENCODERS = [*map(PatchNormalisation, "ABC"), GaborBank(), OrientedEdges()]


@pytest.mark.parametrize("encoder", ENCODERS, ids=str)
def test_neighbours_threads_and_layout_in_memory_change_nothing_and_frames_stay_as_they_were(encoder):
    frame, before = smooth_frame(32, 64, 5), torch.get_num_threads()
    locked = frame.copy()
    locked.flags.writeable = False
    frames = [frame, locked, np.asfortranarray(frame), frame[:, ::-1][:, ::-1], np.zeros((90, 160, 3), np.uint8)]
    frames += [smooth_frame(20 + i % 3, 30, seed=i) for i in range(195)]
    alone = np.concatenate([encoder(Images.from_arrays([each])) for each in frames])
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            together = encoder(Images.from_arrays(frames))
            assert together.dtype == (np.uint8 if isinstance(encoder, PatchNormalisation) else np.float32)
            assert np.array_equal(together, alone)
    finally:
        torch.set_num_threads(before)
    assert (alone[:4] == alone[0]).all()
    assert encoder(Images.from_arrays([])).shape == (0, alone.shape[1])
    assert np.array_equal(frame, smooth_frame(32, 64, 5))


@pytest.mark.parametrize(
    ("encoder", "argument", "value", "wanted"),
    [
        *((PatchNormalisation, "patch", patch, "the window needs a centre") for patch in (1, 6, -7)),
        *((PatchNormalisation, name, value, "at least 1") for name, value in (("height", 0), ("width", -1))),
        (GaborBank, "height", 5, "give at least 6 pixels"),
        (GaborBank, "block", 4, "a block needs a cell in its centre"),
        (GaborBank, "epsilon", 0.0, "give more than 0"),
        (GaborBank, "patch", 4, "the window needs a centre"),
        (OrientedEdges, "height", 0, "give at least 1"),
        (OrientedEdges, "columns", 0, "give at least 1"),
        (OrientedEdges, "orientations", 1, "give at least 2"),
        (OrientedEdges, "block", 4, "odd"),
        *((OrientedEdges, "epsilon", value, "more than 0") for value in (0.0, math.nan)),
        (OrientedEdges, "power", 0.0, "more than 0"),
    ],
)
def test_arguments_without_a_code_are_refused_by_name(encoder, argument, value, wanted):
    with pytest.raises(BadInput, match=rf"method\.\w*{argument}={value}\b.*{wanted}"):
        encoder(**{argument: value})
    with pytest.raises(BadInput, match="2 thresholds came: give one for each of 32 filters"):
        GaborBank(thresholds=(0.1, 0.2))
