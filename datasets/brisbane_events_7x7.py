"""Brisbane-Event-VPR as LENS has it: a drive at two sunsets, events counted in 49 pixels of a DAVIS346."""

from __future__ import annotations

from dataclasses import replace

from vprbench.api import Dataset

from .folders import folders
from .readers.file_dataset import Unmatched
from .readers.frame_folders import find_root

_HOLDING = "sunset1, sunset2 and ground_truth.npz"
_NOTE = "LENS is scored on sequences of 2 within 3 places; here each frame is asked, by the ground truth as it is"


def brisbane_events_7x7(
    name: str, root: str | None = None, unmatched: Unmatched = "keep", default_root: str | None = None
) -> Dataset:
    """Return sunset2 as places and sunset1 as queries, all frames, with the ground truth of AdamDHines/LENS (f44a08c).

    `default_root` is relative to the checkout. Raises MissingData where files are missing, BadInput for another
    ground truth.
    """
    layout = f"run python -m vprbench fetch brisbane_events_7x7, or set dataset.root to what holds {_HOLDING}"
    top = find_root(name, root, _HOLDING, layout, default_root=default_root)
    places, queries, truth = (str(top / part) for part in ("sunset2", "sunset1", "ground_truth.npz"))
    whole = folders(name, [places], queries, truth, unmatched=unmatched)
    return replace(whole, protocol={**whole.protocol, "protocol": "lens_frames"}, notes=(*whole.notes, _NOTE))
