"""Messages of the queue: contributions to the storing worker, and their outcomes back.

    u32 length of the header | msgpack header | rows of OBSERVATION

The header is [version, reply, [vehicle, kind, id, datum, map_version, epoch_year, covariance, records, refusal] of each
contribution]; `refusal` is None, or code and text of the receiving worker's refusal. Refused contributions are sent
too: one that the ledger knows is a duplicate. The reply is msgpack, [version, [status, refusal] of each].
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgpack
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator

from camber.map_update.admission import Refusal
from camber.map_update.contribution import OBSERVATION, Contribution, Kind
from camber.map_update.stores.upload_deduplication import Outcome
from camber.schemas.base import Count, Covariance3, Name
from camber.schemas.fleet import EpochYear

VERSION = 1  # of the message format
_LENGTH = struct.Struct("<I")
_MAX_HEADER = 4 << 20  # chosen: a bound on what untrusted bytes make the parser read
_FLOATS = [name for name in OBSERVATION.names or () if OBSERVATION[name].kind == "f"]
_STRICT = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)


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
    """The fields in the order of the message; named as in Contribution."""

    model_config = _STRICT
    vehicle: Name
    kind: Kind
    id: Name
    datum: Name
    map_version: Count
    epoch_year: EpochYear
    position_covariance_enu_m2: Covariance3 | None
    records: Annotated[int, Field(ge=0, le=1 << 24)]
    refusal: Refusal | None

    @model_validator(mode="before")
    @classmethod
    def _name_fields(cls, values: Any) -> dict[str, Any]:
        return dict(zip(cls.model_fields, values, strict=True))


_Reply = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.$-]{1,128}$")]
_CONTRIBUTIONS = TypeAdapter(tuple[Literal[1], _Reply, tuple[_ContributionHeader, ...]], config=_STRICT)
_OUTCOMES = TypeAdapter(tuple[Literal[1], tuple[Outcome, ...]], config=_STRICT)


def pack_contributions(reply: str, queued: Sequence[QueuedContribution]) -> bytes:
    """Encode contributions, and the subject on which their sender waits."""
    headers = []
    for item in queued:
        c = item.contribution
        common = (*c.name, c.datum, c.map_version, c.epoch_year, c.position_covariance_enu_m2)
        headers.append((*common, len(c.observations), item.refusal))
    header: bytes = msgpack.packb([VERSION, reply, headers])
    rows = (item.contribution.observations.tobytes() for item in queued)
    return b"".join([_LENGTH.pack(len(header)), header, *rows])


def unpack_contributions(data: bytes) -> tuple[str, list[QueuedContribution]]:
    """Decode reply subject and contributions; raises only QueueMessageError, for any bytes."""
    with _errors_named():
        (length,) = _LENGTH.unpack_from(data)
        values = msgpack.unpackb(data[_LENGTH.size : _LENGTH.size + min(length, _MAX_HEADER)], use_list=False)
        _, reply, headers = _CONTRIBUTIONS.validate_python(values)
        rows = np.frombuffer(data, OBSERVATION, offset=_LENGTH.size + length)
        ends = np.cumsum([header.records for header in headers], dtype=np.int64).tolist() or [0]
        if len(rows) != ends[-1]:
            raise QueueMessageError(f"{len(rows)} rows, expected {ends[-1]}")
        if not all(np.isfinite(rows[name]).all() for name in _FLOATS):
            raise QueueMessageError("expected finite numbers")
        queued = []
        for header, part in zip(headers, np.split(rows, ends[:-1]), strict=False):
            fields = header.model_dump(exclude={"records", "refusal"})
            queued.append(QueuedContribution(Contribution(**fields, observations=part), header.refusal))
        return reply, queued


def pack_outcomes(outcomes: Sequence[Outcome]) -> bytes:
    """Encode the outcomes of a message's contributions, in their order."""
    data: bytes = msgpack.packb([VERSION, outcomes])
    return data


def unpack_outcomes(data: bytes) -> list[Outcome]:
    """Decode outcomes; raises only QueueMessageError, for any bytes."""
    with _errors_named():
        return list(_OUTCOMES.validate_python(msgpack.unpackb(data, use_list=False))[1])


@contextmanager
def _errors_named() -> Iterator[None]:
    try:
        yield
    except (
        ValueError,
        TypeError,
        msgpack.UnpackException,
        struct.error,
        RecursionError,
        OverflowError,
    ) as error:
        raise QueueMessageError(str(error)[:300]) from None
