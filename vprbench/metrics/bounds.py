"""What the fields of a stored dataclass may hold: annotations that pydantic checks when a file is read or written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, ValidationInfo
    from pydantic_core import CoreSchema

INTEGERS, NUMBERS = ("int32", "int64"), ("float32", "float64")
HIGHEST_SCORE = float(np.finfo(np.float32).max)
MOST_PLACES = 100_000_000  # of a map; one number of each fills 0.8 GB

Text = Annotated[str, Field(strict=True)]
Name = Annotated[str, Field(strict=True, pattern=r"^[^./\\\x00-\x1f][^/\\\x00-\x1f]*$")]  # of a file too
Flag = Annotated[bool, Field(strict=True)]
Count = Annotated[int, Field(strict=True, ge=0, le=1 << 53)]
Positive = Annotated[int, Field(strict=True, ge=1, le=1 << 53)]
Places = Annotated[int, Field(strict=True, ge=1, le=MOST_PLACES)]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Amount = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Seconds = Annotated[float, Field(strict=True, ge=0, le=1e9, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, ge=0, le=1)]


@dataclass(frozen=True)
class Array:
    """An array's types, the names of its axes, and its lowest and highest value, a name standing for a length.

    The validation context maps names to lengths; the first array that has an axis sets its length for the others.
    """

    kinds: tuple[str, ...]
    axes: tuple[str | None, ...]  # None: of any length
    lowest: float
    highest: float | str
    positive_median: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check an array by this, whatever its annotation says."""
        from pydantic_core import core_schema

        return core_schema.with_info_plain_validator_function(self._check_array)

    def _check_array(self, array: Any, info: ValidationInfo) -> Any:
        lengths: dict[str, int] = {} if info.context is None else info.context
        if not isinstance(array, np.ndarray) or array.dtype.name not in self.kinds:
            came = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
            raise ValueError(f"is {came}; wanted an array of {' or '.join(self.kinds)}")
        if array.ndim != len(self.axes) or any(
            axis is not None and lengths.setdefault(axis, length) != length
            for axis, length in zip(self.axes, array.shape, strict=True)
        ):
            raise ValueError(f"is of shape {array.shape}; wanted ({', '.join(map(str, self.axes))})")
        highest = lengths[self.highest] if isinstance(self.highest, str) else self.highest
        if array.size and not (array.min() >= self.lowest and array.max() <= highest):  # NaN is neither
            raise ValueError(f"runs from {array.min()} to {array.max()}; wanted {self.lowest} to {highest}")
        if self.positive_median and not np.median(array) > 0:
            raise ValueError("has no median above 0")
        return array


@dataclass(frozen=True)
class Fits:
    """A plain value that has to be as a model says; it stays as it is, parts that the model does not name included."""

    model: Any

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check a value by the model."""
        from pydantic_core import core_schema

        def check_value(value: Any, check: Callable[[Any], Any]) -> Any:
            check(value)
            return value

        as_it_is = core_schema.plain_serializer_function_ser_schema(lambda value: value)
        return core_schema.no_info_wrap_validator_function(
            check_value, handler.generate_schema(self.model), serialization=as_it_is
        )
