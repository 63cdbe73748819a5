"""What vehicles upload, and what the cloud says back."""

from __future__ import annotations

import json
from typing import Annotated, Literal, Self, get_args
from unicodedata import category

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from camber.schemas.base import (
    ArrayOf,
    Count,
    Covariance3,
    Float32,
    Float64,
    Height,
    Int32,
    Int64,
    Latitude,
    Longitude,
    Message,
    Model,
    Name,
    Sha256,
    Sigma,
    Text,
    UInt8,
)
from camber.schemas.gnss import Quality
from camber.schemas.integrity import VerdictValue

HeldReason = Literal[
    "other", "vehicles_not_known", "disagreed", "too_large", "regional_shift", "step", "not_significant",
    "false_discovery", "too_few_vehicles", "too_few_days", "rests_on_few",
]  # fmt: skip
HELD_REASONS: tuple[HeldReason, ...] = get_args(HeldReason)
EpochYear = Annotated[float, Field(ge=1980.0, le=2200.0)]


class ElevationUpload(Message):
    """One observation of a road's height; `time_ns` is the positioning time (JP7707657B2).

    It is free of the map's height and of any correction learnt against it. σ and covariance are those of a right fix,
    which are larger than a receiver claims.
    """

    vehicle: Name
    upload_id: Name = Field(description="unique per vehicle; the server keeps each once")
    fix_id: Count
    fix_quality: Quality
    verdict: VerdictValue
    latitude_rad: Latitude
    longitude_rad: Longitude
    road_height_m: Height = Field(description="h_r − h_a, ellipsoidal")
    road_height_sigma_m: Sigma
    antenna_height_m: Annotated[float, Field(ge=-1.0, le=100.0)]
    position_covariance_enu_m2: Covariance3
    datum: Name
    epoch_year: EpochYear
    map_version: Count
    surface_id: Count


class UploadBatch(Message):
    """Many observations of one vehicle as columns; `time_ns` is that of the last, `epoch_year` that of the first.

    `verdict` and `fix_quality` are indices into the words of ElevationUpload, in their order.
    """

    vehicle: Name
    batch_id: Name
    datum: Name
    epoch_year: EpochYear
    map_version: Count
    positioning_time_ns: Annotated[Int64, ArrayOf("<i8", ("records",))]
    fix_id: Annotated[Int64, ArrayOf("<i8", ("records",), ge=0)]
    fix_quality: Annotated[UInt8, ArrayOf("|u1", ("records",), le=7)]
    surface_id: Annotated[Int64, ArrayOf("<i8", ("records",))]
    verdict: Annotated[UInt8, ArrayOf("|u1", ("records",), le=3)]
    latitude_rad: Annotated[Float64, ArrayOf("<f8", ("records",))]
    longitude_rad: Annotated[Float64, ArrayOf("<f8", ("records",))]
    horizontal_sigma_m: Annotated[Float64, ArrayOf("<f8", ("records",), ge=0.0)] = Field(
        description="of the position, in its worst direction"
    )
    road_height_m: Annotated[Float64, ArrayOf("<f8", ("records",))]
    road_height_sigma_m: Annotated[Float64, ArrayOf("<f8", ("records",), ge=0.0)]
    antenna_height_m: Annotated[Float64, ArrayOf("<f8", ("records",))]


class UploadReceipt(Message):
    """Sent only after the upload is committed to disk."""

    vehicle: Name
    upload_id: Name
    status: Literal["stored", "duplicate", "refused"]
    reason: Text = ""


class ReleaseHead(Message):
    """There is a release of the map: fetch what you lack."""

    region: Name
    map_version: Count
    manifest_sha256: Sha256


class MapRootRequest(Message):
    """Which release of a region is the newest?"""

    region: Name
    have_sha256: Sha256 | None = Field(None, description="manifest of the release the asker has")


class MapRootReply(Message):
    """The root of the newest release, as its bytes; it is signed itself, so that it may come from anywhere."""

    status: Literal["known", "unchanged", "unknown"]
    reason: Text = ""
    payload: Annotated[UInt8, ArrayOf("|u1", ("bytes",))]


class MapBlobRequest(Message):
    """A manifest or a tile by its hash, packed as `camber.road_map.blob_delta` does, a part of it."""

    sha256: Sha256
    base_sha256: Sha256 | None = Field(
        None, description="a blob that the asker has: the reply may be a difference against it"
    )
    part: Annotated[int, Field(ge=0, lt=1 << 16)] = 0
    more_sha256: tuple[Sha256, ...] = Field(
        (), max_length=64, description="blobs wanted next, as far as they fit into the same reply"
    )
    more_base_sha256: tuple[Sha256 | None, ...] = Field(
        (), max_length=64, description="as `base_sha256`, one for each of these"
    )


class MapBlobReply(Message):
    """A part of a packed blob, at most 256 kB. The receiver of all parts verifies the result by its hash.

    After the only part of a blob the first of the blobs wanted next follow as a whole, packed, one after the other.
    """

    status: Literal["known", "unknown"]
    reason: Text = ""
    parts: Annotated[int, Field(ge=0, le=1 << 16)] = 0
    payload: Annotated[UInt8, ArrayOf("|u1", ("bytes",))]
    more_bytes: Annotated[Int32, ArrayOf("<i4", ("more",))]
    more_payload: Annotated[UInt8, ArrayOf("|u1", ("bytes of more",))]


class HeldChanges(Model):
    """Changes of road surfaces that wait for review or for votes, one row each; heights are from the map's reference.

    `reason` is the place of a term in `HELD_REASONS`, the place that of the surface's middle.
    """

    surface_id: Annotated[Int64, ArrayOf("<i8", ("changes",), ge=0)]
    link_id: Annotated[Int64, ArrayOf("<i8", ("changes",), ge=0)]
    latitude_rad: Annotated[Float64, ArrayOf("<f8", ("changes",))]
    longitude_rad: Annotated[Float64, ArrayOf("<f8", ("changes",))]
    in_map_m: Annotated[Float32, ArrayOf("<f4", ("changes",))] = Field(
        description="the correction in the map"
    )
    offset_m: Annotated[Float32, ArrayOf("<f4", ("changes",))] = Field(description="by the votes")
    standard_error_m: Annotated[Float32, ArrayOf("<f4", ("changes",), ge=0.0)]
    agreement: Annotated[Float32, ArrayOf("<f4", ("changes",), ge=0.0, le=1.0)] = Field(
        description="share of the vehicles that agree"
    )
    vehicles: Annotated[Int32, ArrayOf("<i4", ("changes",), ge=0)]
    votes: Annotated[Int32, ArrayOf("<i4", ("changes",), ge=0)]
    days: Annotated[Int32, ArrayOf("<i4", ("changes",), ge=0)]
    reason: Annotated[UInt8, ArrayOf("|u1", ("changes",), le=len(HELD_REASONS) - 1)]


class PublishedChanges(Model):
    """Surfaces whose height in the map is that of the fleet, one row each; `offset_m` is from the reference."""

    surface_id: Annotated[Int64, ArrayOf("<i8", ("changes",), ge=0)]
    link_id: Annotated[Int64, ArrayOf("<i8", ("changes",), ge=0)]
    latitude_rad: Annotated[Float64, ArrayOf("<f8", ("changes",))]
    longitude_rad: Annotated[Float64, ArrayOf("<f8", ("changes",))]
    offset_m: Annotated[Float32, ArrayOf("<f4", ("changes",))]
    sigma_m: Annotated[Float32, ArrayOf("<f4", ("changes",), ge=0.0)]
    vehicles: Annotated[Int32, ArrayOf("<i4", ("changes",), ge=0)]
    since_map_version: Annotated[Int64, ArrayOf("<i8", ("changes",), ge=0)]


class RegionAlarms(Model):
    """Regions most of whose surfaces moved alike, one row each: a base station, a datum or the survey, not the roads.

    The place is the middle of the region's surfaces. `everywhere`: 1 where the region is the whole map.
    """

    everywhere: Annotated[UInt8, ArrayOf("|u1", ("alarms",), le=1)]
    latitude_rad: Annotated[Float64, ArrayOf("<f8", ("alarms",))]
    longitude_rad: Annotated[Float64, ArrayOf("<f8", ("alarms",))]
    shift_m: Annotated[Float32, ArrayOf("<f4", ("alarms",))]
    share: Annotated[Float32, ArrayOf("<f4", ("alarms",), ge=0.0, le=1.0)]
    surfaces: Annotated[Int32, ArrayOf("<i4", ("alarms",), ge=0)]


class MapChangesRequest(Message):
    """Which changes of the map are pending, held, published and alarmed?"""


class MapChanges(Message):
    """Changes of the map after the last fusion; `unknown` before the first one, and of a worker that fuses nothing."""

    status: Literal["known", "unknown"]
    reason: Text = ""
    map_version: Count | None = None
    reference_sha256: Sha256 | None = Field(None, description="manifest of the map's reference")
    held: HeldChanges | None = None
    pending: HeldChanges | None = Field(None, description="those that wait for more votes")
    published: PublishedChanges | None = None
    alarms: RegionAlarms | None = None
    left_out: Count = Field(
        0, description="rows without room: the smallest held, the oldest published, pending ones"
    )


class MapVotesRequest(Message):
    """How did the votes on a surface come in?"""

    surface_id: Count


class MapVotes(Message):
    """Votes on a surface, a row for each day: how many vehicles voted, the median and the quartiles of their offsets.

    Offsets are from the reference, with the biases of vehicles. `day`: since 1970, in mean solar time from 04:00.
    """

    status: Literal["known", "unknown"]
    reason: Text = ""
    day: Annotated[Int32, ArrayOf("<i4", ("days",))]
    vehicles: Annotated[Int32, ArrayOf("<i4", ("days",), ge=0)]
    offset_m: Annotated[Float32, ArrayOf("<f4", ("days",))]
    low_m: Annotated[Float32, ArrayOf("<f4", ("days",))]
    high_m: Annotated[Float32, ArrayOf("<f4", ("days",))]
    left_out: Count = Field(0, description="days of one or two vehicles, whose votes are not shown")


ReviewAction = Literal["accept", "reject", "roll_back"]
OffsetOfVotes = Annotated[float, Field(ge=-100.0, le=100.0)]


def _printable(text: str) -> str:
    """Check a text that terminals show: no control characters."""
    if not text.strip() or not all(each.isprintable() or category(each) == "Zs" for each in text):
        raise PydanticCustomError("printable", "printable characters, not spaces alone")
    return text


class MapDecision(Message):
    """An operator's decision on a change of the map, or to go back to an earlier release; with who and why.

    The signature is over `decision_bytes`. `time_ns`: when it was made.
    """

    action: ReviewAction
    surface_id: Count | None = Field(None, description="whose change is accepted or rejected")
    offset_m: OffsetOfVotes | None = Field(None, description="offset of the votes as the operator saw it")
    map_version: Count | None = Field(
        None, description="release whose corrections come again, with `roll_back`"
    )
    reference_sha256: Sha256 = Field(description="manifest of the reference of the map that is decided on")
    who: Annotated[str, Field(min_length=1, max_length=64), AfterValidator(_printable)]
    why: Annotated[str, Field(min_length=1, max_length=400), AfterValidator(_printable)]
    key_id: Name | None = Field(None, description="which key signed; None: unsigned")
    signature: Annotated[UInt8, ArrayOf("|u1", (64,))] | None = Field(None, description="Ed25519")

    @model_validator(mode="after")
    def _has_what_its_action_needs(self) -> Self:
        back = self.action == "roll_back"
        for name, needed in (("surface_id", not back), ("offset_m", not back), ("map_version", back)):
            if (getattr(self, name) is not None) != needed:
                expected = f"{self.action} {'with' if needed else 'without'} {name}"
                raise PydanticCustomError("action", "{expected}", {"expected": expected})
        if (self.key_id is None) != (self.signature is None):
            raise PydanticCustomError("signed", "key_id and signature, or neither")
        return self


def decision_bytes(decision: MapDecision) -> bytes:
    """What the signature of a decision covers."""
    names = ("action", "surface_id", "offset_m", "map_version", "reference_sha256", "who", "why", "time_ns")
    values = [getattr(decision, name) for name in names]
    return f"camber decision 1\n{json.dumps(values, ensure_ascii=False, separators=(',', ':'))}\n".encode()


class MapDecisionReceipt(Message):
    """Sent after the decision is on the disk, or why it is not.

    `unrecorded`: carried out, but the record could not be written. `elsewhere`: it is on the map of another worker.
    """

    status: Literal["recorded", "unrecorded", "refused", "elsewhere"]
    reason: Text = ""
