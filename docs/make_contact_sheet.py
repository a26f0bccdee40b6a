"""Makes docs/synthetic.png: the same places of the rendered railway in columns, one season in each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vprbench.api.arrays import Image
from vprbench.datasets.synthetic import synthetic
from vprbench.datasets.synthetic.film import HEIGHT, WIDTH

GAP = 4  # pixels between frames
LABEL = 74  # pixels to the left of the frames
HEADING = 20  # pixels above each block of rows


@dataclass(frozen=True)
class Block:
    """Rows that show the same places."""

    traverses: Sequence[str]
    places: Sequence[int]


BLOCKS = (
    Block(("spring", "summer", "fall", "winter"), (118, 805, 960, 1390, 1505, 1827, 2280, 3114)),
    Block(("summer", "winter"), range(1600, 1608)),
)


def frame_corner(block: int, row: int, column: int, blocks: Sequence[Block]) -> tuple[int, int]:
    """Return the top and the left of a frame in the sheet, in pixels."""
    rows_above = sum(len(before.traverses) for before in blocks[:block]) + row
    return (block + 1) * HEADING + rows_above * (HEIGHT + GAP), LABEL + column * (WIDTH + GAP)


def draw_sheet(blocks: Sequence[Block]) -> Image:
    """Return the sheet, RGB."""
    last = blocks[-1]
    bottom, right = frame_corner(len(blocks) - 1, len(last.traverses) - 1, len(last.places) - 1, blocks)
    page = np.full((bottom + HEIGHT + GAP, right + WIDTH + GAP, 3), 255, np.uint8)
    for number, block in enumerate(blocks):
        for row, traverse in enumerate(block.traverses):
            shown = synthetic(places=max(block.places) + 10, references=[traverse], query=traverse).references
            for column, place in enumerate(block.places):
                top, left = frame_corner(number, row, column, blocks)
                page[top : top + HEIGHT, left : left + WIDTH] = shown[place]
                if row == 0:
                    _write(page, f"place {place}", left + 2, top - 6)
            _write(page, traverse, 8, top + HEIGHT // 2)
    return page


def _write(page: Image, text: str, left: int, base: int) -> None:
    cv2.putText(page, text, (left, base), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)


if __name__ == "__main__":
    cv2.imwrite(
        str(Path(__file__).with_name("synthetic.png")),
        cv2.cvtColor(draw_sheet(BLOCKS), cv2.COLOR_RGB2BGR),
        [cv2.IMWRITE_PNG_COMPRESSION, 9],
    )
