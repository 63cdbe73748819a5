"""The base of all messages, and the types they are made of.

A message is frozen and strict: no coercion, no unknown field, no NaN, no infinity. A quantity that is not known
is `None` or a word of a `Literal`, never a zero. Frames, heights and times are those of `docs/conventions.md`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from camber.schemas.arrays import ArrayOf, arrays_of, check_lengths

__all__ = ["ArrayOf", "Message", "Model", "arrays_of", "check_lengths"]

# An epoch after 2080 or before 2000 is a fault of the sender's clock (week roll-over, a fix in 2089), not a time.
EARLIEST_NS = 630_720_000 * 1_000_000_000
LATEST_NS = 3_155_760_000 * 1_000_000_000

TimeNs = Annotated[int, Field(ge=EARLIEST_NS, le=LATEST_NS)]
"""GPS time in integer nanoseconds since 1980-01-06T00:00:00, without leap seconds."""

MAX_ITEMS = 256
"""The most that a tuple or a mapping of any message may hold: each says its own `max_length` up to this. What is
longer belongs into arrays."""

Count = Annotated[int, Field(ge=0, le=2**62)]
Sigma = Annotated[float, Field(ge=0.0, le=1e9)]
Latitude = Annotated[float, Field(ge=-1.5707963267948968, le=1.5707963267948968)]
Longitude = Annotated[float, Field(ge=-3.1415926535897936, le=3.1415926535897936)]
Height = Annotated[float, Field(ge=-20_000.0, le=100_000.0)]
Speed = Annotated[float, Field(ge=-1_000.0, le=1_000.0)]
Angle = Annotated[float, Field(ge=-7.0, le=7.0)]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:@+-]*$")]
Text = Annotated[str, Field(max_length=512)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Component = Annotated[float, Field(ge=-1e9, le=1e9)]
_Variance = Annotated[float, Field(ge=0.0, le=1e18)]
_Covariance = Annotated[float, Field(ge=-1e18, le=1e18)]
Vector2 = tuple[_Component, _Component]
Vector3 = tuple[_Component, _Component, _Component]
Covariance3 = tuple[_Variance, _Covariance, _Covariance, _Variance, _Covariance, _Variance]
"""Upper triangle (xx, xy, xz, yy, yz, zz) of a symmetric 3×3 covariance."""
Covariance2 = tuple[_Variance, _Covariance, _Variance]
"""Upper triangle (xx, xy, yy) of a symmetric 2×2 covariance."""

Float64 = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]
Int64 = npt.NDArray[np.int64]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]


class Model(BaseModel):
    """A strict, frozen part of a message; equal when all its fields are, arrays included."""

    model_config = ConfigDict(
        strict=True, frozen=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    @model_validator(mode="after")
    def _lengths_agree(self) -> Self:
        check_lengths(self)
        return self

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        mine, theirs = self.__dict__, other.__dict__
        return all(
            np.array_equal(value, theirs[name]) if isinstance(value, np.ndarray) else value == theirs[name]
            for name, value in mine.items()
        )


class Message(Model):
    """What travels on its own: over a channel, in a query or in a file."""

    SCHEMA_VERSION: ClassVar[int] = 1
    time_ns: TimeNs = Field(description="time of measurement, GPS time")

    @classmethod
    def schema_name(cls) -> str:
        """Name and version, as they stand in the encoding: `camber.Fix.v1`."""
        return f"camber.{cls.__name__}.v{cls.SCHEMA_VERSION}"
