"""What goes over the queue: contributions to who stores them, and back what became of each.

    u32 length of the header | msgpack header | rows of OBSERVATION

The header is [version, reply, [vehicle, kind, id, datum, map_version, epoch_year, covariance, records, refusal] of each
contribution]; `refusal` is None, or the code and the text of why who received it would not have it. It is sent all the
same: what the ledger knows already is a duplicate and not refused. The way back is msgpack, [version, [status, code,
text] of each].
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgpack
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from camber.map_update.admission import Refusal
from camber.map_update.contribution import OBSERVATION, Contribution, Kind
from camber.map_update.stores.store import Outcome
from camber.schemas.base import Count, Covariance3, Name, Text
from camber.schemas.fleet import EpochYear

VERSION = 1
_LENGTH = struct.Struct("<I")
_MAX_HEADER = 4 << 20
_STRICT = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)
_Complaint = tuple[Name, Text]


class QueueError(RuntimeError):
    """The queue took nothing, or said nothing in time: nothing of this may be acknowledged."""


class QueueMessageError(ValueError):
    """These bytes are no message of this queue."""


@dataclass(frozen=True, slots=True)
class QueuedContribution:
    """A contribution, and why who received it would refuse it if it is not known already."""

    contribution: Contribution
    refusal: Refusal | None


class _Heading(BaseModel):
    model_config = _STRICT
    vehicle: Name
    kind: Kind
    id: Name
    datum: Name
    map_version: Count
    epoch_year: EpochYear
    covariance: Covariance3 | None
    records: Annotated[int, Field(ge=0, le=1 << 24)]
    refusal: _Complaint | None


class _Result(BaseModel):
    model_config = _STRICT
    status: Literal["stored", "duplicate", "refused"]
    refusal: _Complaint | None


_HEADING, _RESULT = list(_Heading.model_fields), list(_Result.model_fields)
_REPLY: TypeAdapter[str] = TypeAdapter(Annotated[str, Field(pattern=r"^[A-Za-z0-9_.$-]{1,128}$")])


def pack_parcels(reply: str, parcels: Sequence[QueuedContribution]) -> bytes:
    """Contributions, and the subject on which their sender waits."""
    headings = []
    for parcel in parcels:
        c, refusal = parcel.contribution, parcel.refusal
        covariance = c.position_covariance_enu_m2
        headings.append(
            [
                *(c.vehicle, c.kind, c.id, c.datum, c.map_version, c.epoch_year, covariance),
                len(c.observations),
                None if refusal is None else (refusal.code, refusal.text[:512]),
            ]
        )
    header: bytes = msgpack.packb([VERSION, reply, headings])
    rows = (parcel.contribution.observations.tobytes() for parcel in parcels)
    return b"".join([_LENGTH.pack(len(header)), header, *rows])


def unpack_parcels(data: bytes) -> tuple[str, list[QueuedContribution]]:
    """Raises QueueMessageError, and nothing else, for whatever is no message."""
    try:
        (length,) = _LENGTH.unpack_from(data)
        version, reply, headings = _unpacked(data[_LENGTH.size : _LENGTH.size + min(length, _MAX_HEADER)], 3)
        reply = _REPLY.validate_python(reply, strict=True)
        found = [_heading(values) for values in headings]
        offset, parcels = _LENGTH.size + length, []
        if version != VERSION or len(data) - offset != OBSERVATION.itemsize * sum(h.records for h in found):
            raise QueueMessageError(
                f"{len(data)} bytes of version {version!r}, expected another length or {VERSION}"
            )
        for heading in found:
            rows = np.frombuffer(data, OBSERVATION, heading.records, offset)
            offset += rows.nbytes
            parcels.append(_parcel(heading, rows))
    except (ValidationError, ValueError, TypeError, struct.error, RecursionError, OverflowError) as error:
        raise QueueMessageError(str(error)[:300]) from None
    return reply, parcels


def pack_outcomes(outcomes: Sequence[Outcome]) -> bytes:
    """What became of the contributions of a message, in their order."""
    rows = [
        [
            outcome.status,
            None if outcome.refusal is None else (outcome.refusal.code, outcome.refusal.text[:512]),
        ]
        for outcome in outcomes
    ]
    data: bytes = msgpack.packb([VERSION, rows])
    return data


def unpack_outcomes(data: bytes) -> list[Outcome]:
    """Raises QueueMessageError, and nothing else, for whatever is no answer."""
    try:
        version, rows = _unpacked(data, 2)
        if version != VERSION:
            raise QueueMessageError(f"version {version!r}, expected {VERSION}")
        results = [
            _Result.model_validate(dict(zip(_RESULT, _of_length(row, 2), strict=True))) for row in rows
        ]
    except (ValidationError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise QueueMessageError(str(error)[:300]) from None
    return [Outcome(r.status, None if r.refusal is None else Refusal(*r.refusal)) for r in results]


def _heading(values: object) -> _Heading:
    return _Heading.model_validate(dict(zip(_HEADING, _of_length(values, len(_HEADING)), strict=True)))


def _parcel(heading: _Heading, rows: np.ndarray[tuple[int], np.dtype[np.void]]) -> QueuedContribution:
    if not all(
        np.isfinite(rows[name]).all() for name in OBSERVATION.names or () if OBSERVATION[name].kind == "f"
    ):
        raise QueueMessageError("expected finite numbers")
    contribution = Contribution(
        vehicle=heading.vehicle,
        kind=heading.kind,
        id=heading.id,
        datum=heading.datum,
        map_version=heading.map_version,
        epoch_year=heading.epoch_year,
        position_covariance_enu_m2=heading.covariance,
        observations=rows,
    )
    return QueuedContribution(contribution, None if heading.refusal is None else Refusal(*heading.refusal))


def _unpacked(data: bytes, length: int) -> tuple[Any, ...]:
    try:
        values = msgpack.unpackb(data, use_list=False)
    except (ValueError, msgpack.UnpackException) as error:
        raise QueueMessageError(f"no msgpack: {error}") from None
    return _of_length(values, length)


def _of_length(values: object, length: int) -> tuple[Any, ...]:
    if not isinstance(values, tuple) or len(values) != length:
        raise QueueMessageError(f"expected {length} values")
    return values
