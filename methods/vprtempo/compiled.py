"""How VPRTempo's inner loops are compiled."""

from __future__ import annotations

from vprbench.api import compiled as exactly_compiled

#: Sums may be reordered; infinities still count.
compiled = exactly_compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
