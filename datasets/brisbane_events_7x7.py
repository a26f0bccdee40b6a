"""Brisbane-Event-VPR as LENS has it: a drive at two sunsets, events counted in 49 pixels of a DAVIS346."""

from __future__ import annotations

from dataclasses import replace

from vprbench.api import Dataset

from .folders import folders
from .readers.file_dataset import Unmatched
from .readers.frame_folders import root_folder

_MATRIX = "ground_truth.npz"
_NOTE = (
    "LENS is scored on sequences of 2 with a tolerance of 3 places; here every frame is asked, with the ground truth "
    "as it is"
)


def brisbane_events_7x7(
    name: str = "brisbane_events_7x7",
    root: str | None = None,
    reference: str = "sunset2",
    query: str = "sunset1",
    unmatched: Unmatched = "keep",
    default_root: str | None = None,
) -> Dataset:
    """Return all frames of both drives, in natural order, with the ground truth of AdamDHines/LENS (f44a08c).

    Every reference is a place. `default_root` is relative to the checkout. Raises NotThere for what is missing,
    BadInput for a ground truth of another shape.
    """
    holding = f"{reference}, {query} and {_MATRIX}"
    layout = f"set dataset.root to the folder that holds {holding} (frames: github.com/AdamDHines/LENS, davis346)"
    top = root_folder(name, root, holding, layout, default_root=default_root)
    whole = folders(
        name, [str(top / reference)], str(top / query), ground_truth=str(top / _MATRIX), unmatched=unmatched
    )
    return replace(whole, protocol={**whole.protocol, "protocol": "lens_frames"}, notes=(*whole.notes, _NOTE))
