"""Messages of the queue: contributions to the storing worker, and their outcomes back.

    u32 length of the header | msgpack header | rows of OBSERVATION

The header is [version, reply, [vehicle, kind, id, datum, map_version, epoch_year, covariance, records, refusal] of each
contribution]; `refusal` is None, or code and text of the receiving worker's refusal. Refused contributions are sent
too: one that the ledger knows is a duplicate. The reply is msgpack, [version, [status, refusal] of each].
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

VERSION = 1  # of the message format
_LENGTH = struct.Struct("<I")
_MAX_HEADER = 4 << 20  # chosen: a bound on what untrusted bytes make the parser read
_STRICT = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)
_RefusalFields = tuple[Name, Text]


class QueueError(RuntimeError):
    """The queue accepted nothing, or did not reply in time: nothing may be acknowledged."""


class QueueMessageError(ValueError):
    """These bytes are not a message of this queue."""


@dataclass(frozen=True, slots=True)
class QueuedContribution:
    """A contribution, and the receiving worker's refusal, which applies if the ledger does not know it."""

    contribution: Contribution
    refusal: Refusal | None


class _ContributionHeader(BaseModel):
    model_config = _STRICT
    vehicle: Name
    kind: Kind
    id: Name
    datum: Name
    map_version: Count
    epoch_year: EpochYear
    covariance: Covariance3 | None
    records: Annotated[int, Field(ge=0, le=1 << 24)]
    refusal: _RefusalFields | None


class _OutcomeFields(BaseModel):
    model_config = _STRICT
    status: Literal["stored", "duplicate", "refused"]
    refusal: _RefusalFields | None


_HEADER_FIELDS, _OUTCOME = list(_ContributionHeader.model_fields), list(_OutcomeFields.model_fields)
_REPLY: TypeAdapter[str] = TypeAdapter(Annotated[str, Field(pattern=r"^[A-Za-z0-9_.$-]{1,128}$")])


def pack_contributions(reply: str, queued: Sequence[QueuedContribution]) -> bytes:
    """Encode contributions, and the subject on which their sender waits."""
    headers = []
    for item in queued:
        c = item.contribution
        covariance = c.position_covariance_enu_m2
        fields = (*c.name, c.datum, c.map_version, c.epoch_year, covariance, len(c.observations))
        headers.append([*fields, _refusal_fields(item.refusal)])
    header: bytes = msgpack.packb([VERSION, reply, headers])
    rows = (item.contribution.observations.tobytes() for item in queued)
    return b"".join([_LENGTH.pack(len(header)), header, *rows])


def unpack_contributions(data: bytes) -> tuple[str, list[QueuedContribution]]:
    """Decode reply subject and contributions; raises only QueueMessageError, for any bytes."""
    try:
        (length,) = _LENGTH.unpack_from(data)
        version, reply, headers = _unpacked(data[_LENGTH.size : _LENGTH.size + min(length, _MAX_HEADER)], 3)
        reply = _REPLY.validate_python(reply, strict=True)
        parsed = [_ContributionHeader.model_validate(_named(_HEADER_FIELDS, values)) for values in headers]
        offset, queued = _LENGTH.size + length, []
        if version != VERSION or len(data) - offset != OBSERVATION.itemsize * sum(h.records for h in parsed):
            raise QueueMessageError(
                f"{len(data)} bytes of version {version!r}, expected another length or {VERSION}"
            )
        for fields in parsed:
            rows = np.frombuffer(data, OBSERVATION, fields.records, offset)
            offset += rows.nbytes
            queued.append(_queued(fields, rows))
    except (ValidationError, ValueError, TypeError, struct.error, RecursionError, OverflowError) as error:
        raise QueueMessageError(str(error)[:300]) from None
    return reply, queued


def pack_outcomes(outcomes: Sequence[Outcome]) -> bytes:
    """Encode the outcomes of a message's contributions, in their order."""
    rows = [[outcome.status, _refusal_fields(outcome.refusal)] for outcome in outcomes]
    data: bytes = msgpack.packb([VERSION, rows])
    return data


def unpack_outcomes(data: bytes) -> list[Outcome]:
    """Decode outcomes; raises only QueueMessageError, for any bytes."""
    try:
        version, rows = _unpacked(data, 2)
        if version != VERSION:
            raise QueueMessageError(f"version {version!r}, expected {VERSION}")
        results = [_OutcomeFields.model_validate(_named(_OUTCOME, row)) for row in rows]
    except (ValidationError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise QueueMessageError(str(error)[:300]) from None
    return [Outcome(r.status, None if r.refusal is None else Refusal(*r.refusal)) for r in results]


def _refusal_fields(refusal: Refusal | None) -> tuple[str, str] | None:
    return None if refusal is None else (refusal.code, refusal.text[:512])


def _named(names: Sequence[str], values: object) -> dict[str, Any]:
    return dict(zip(names, _of_length(values, len(names)), strict=True))


def _queued(
    fields: _ContributionHeader, rows: np.ndarray[tuple[int], np.dtype[np.void]]
) -> QueuedContribution:
    if not all(
        np.isfinite(rows[name]).all() for name in OBSERVATION.names or () if OBSERVATION[name].kind == "f"
    ):
        raise QueueMessageError("expected finite numbers")
    contribution = Contribution(
        vehicle=fields.vehicle,
        kind=fields.kind,
        id=fields.id,
        datum=fields.datum,
        map_version=fields.map_version,
        epoch_year=fields.epoch_year,
        position_covariance_enu_m2=fields.covariance,
        observations=rows,
    )
    return QueuedContribution(contribution, None if fields.refusal is None else Refusal(*fields.refusal))


def _unpacked(data: bytes, length: int) -> tuple[Any, ...]:
    try:
        values = msgpack.unpackb(data, use_list=False)
    except (ValueError, msgpack.UnpackException) as error:
        raise QueueMessageError(f"not msgpack: {error}") from None
    return _of_length(values, length)


def _of_length(values: object, length: int) -> tuple[Any, ...]:
    if not isinstance(values, tuple) or len(values) != length:
        raise QueueMessageError(f"expected {length} values")
    return values
