"""How VPRTempo's inner loops are compiled."""

from __future__ import annotations

from vprbench.api import compiled as loops

#: Sums may be reordered; infinities still count.
compiled = loops.compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
