"""What the fields of a stored dataclass may hold: annotations that pydantic checks when a file is read or written."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

MOST_PLACES = 100_000_000  # of a map; one number of each fills 0.8 GB

Text = Annotated[str, Field(strict=True)]
Name = Annotated[str, Field(strict=True, pattern=r"^[^./\\\x00-\x1f][^/\\\x00-\x1f]*$")]  # of a file too
Flag = Annotated[bool, Field(strict=True)]
Count = Annotated[int, Field(strict=True, ge=0, le=1 << 53)]
Positive = Annotated[int, Field(strict=True, ge=1, le=1 << 53)]
Places = Annotated[int, Field(strict=True, ge=1, le=MOST_PLACES)]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Seconds = Annotated[float, Field(strict=True, ge=0, le=1e9, allow_inf_nan=False)]
