"""From the receiver: bytes as they came, observations, tentative fixes, velocity, other estimates of a fix."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field

from camber.schemas.base import (
    Angle,
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
    Probability,
    Sigma,
    Text,
    TimeNs,
    UInt8,
    Vector3,
)

Known = Literal["yes", "no", "unknown"]
Quality = Literal["fixed", "float", "dgps", "single", "ppp", "sbas", "estimated", "none"]
Protocol = Literal["pos", "nmea", "ubx", "sbf", "rtcm", "rinex", "mixed"]
"""`mixed`: frames and sentences of several protocols, one after another."""
Stream = Literal["rover", "base", "ephemerides"]
AmbiguityMode = Literal["single_epoch", "carried", "unknown"]
SubsetAgreement = Literal["agree", "disagree", "unknown"]
SatelliteUse = Literal[
    "used",
    "integers_unresolved",
    "no_ephemeris",
    "no_pseudorange",
    "below_elevation_mask",
    "below_cn0_mask",
    "outlier",
    "not_differenced",
    "no_position",
    "unhealthy",
    "reason_not_reported",
    "use_not_reported",
]
"""Whether a satellite is in the position, or why not. `integers_unresolved`: only its codes are, of a fixed position.
`outlier`: its codes contradict the others. `not_differenced`: the base has no signal of it that can be paired.
`no_position`: the epoch has none. `no_pseudorange`: also a satellite that a receiver does not track.
`reason_not_reported`: the receiver leaves it out; `use_not_reported`: it does not report whether."""
SATELLITE_USES: tuple[SatelliteUse, ...] = get_args(SatelliteUse)


class ReceiverBytes(Message):
    """What a receiver or its file gave, byte for byte; `time_ns` is when it was received.

    Each stream of one protocol is a stream of bytes of its own. `ephemerides` are whole files, one after another.
    """

    stream: Stream = "rover"
    protocol: Protocol
    payload: Annotated[UInt8, ArrayOf("|u1", ("bytes",))]


class Observations(Message):
    """Raw observations of one epoch at one antenna, one row a signal.

    `satellite` is system letter × 256 + number (ASCII), `signal` the RINEX 3 code as two ASCII bytes (`1C`).
    The bits of `present` say what a row has: 0 pseudorange, 1 phase, 2 Doppler, 3 C/N0, 4 lock.
    """

    station: Name
    satellite: Annotated[Int32, ArrayOf("<i4", ("signals",))]
    signal: Annotated[Int32, ArrayOf("<i4", ("signals",))]
    present: Annotated[UInt8, ArrayOf("|u1", ("signals",))]
    pseudorange_m: Annotated[Float64, ArrayOf("<f8", ("signals",))]
    carrier_phase_cycles: Annotated[Float64, ArrayOf("<f8", ("signals",))]
    doppler_hz: Annotated[Float64, ArrayOf("<f8", ("signals",))]
    cn0_dbhz: Annotated[Float64, ArrayOf("<f8", ("signals",))]
    lock_time_ns: Annotated[Int64, ArrayOf("<i8", ("signals",))]
    slip: Annotated[UInt8, ArrayOf("|u1", ("signals",))]


class SatellitesInView(Message):
    """The satellites of one epoch: direction, C/N0, and which are in the position; one row each.

    Of the RTK engine: those of the systems that it uses. Of a receiver's own position: those that the receiver lists.
    `satellite` is as in Observations; the bits of `present` say what a row has: 0 azimuth and elevation, 1 C/N0. `use`
    is the place of a term in `SATELLITE_USES`.
    """

    quality: Quality = Field(description="of the epoch's position")
    satellite: Annotated[Int32, ArrayOf("<i4", ("satellites",), ge=0, le=0x7FFF)]
    present: Annotated[UInt8, ArrayOf("|u1", ("satellites",))]
    azimuth_rad: Annotated[Float32, ArrayOf("<f4", ("satellites",))] = Field(
        description="clockwise from north"
    )
    elevation_rad: Annotated[Float32, ArrayOf("<f4", ("satellites",))]
    cn0_dbhz: Annotated[Float32, ArrayOf("<f4", ("satellites",))] = Field(
        description="of its strongest signal"
    )
    use: Annotated[UInt8, ArrayOf("|u1", ("satellites",), le=len(SATELLITE_USES) - 1)]


class ReceiverIntegrity(Message):
    """What the receiver says of its own integrity, carried as it is and never mixed with ours.

    `integrity_risk` is the probability, per epoch and axis, that an error exceeds its protection level. RAIM has failed
    where a satellite is named as failed, whether or not the position still uses it.
    """

    horizontal_protection_level_m: Sigma | None = None
    vertical_protection_level_m: Sigma | None = None
    integrity_risk: Probability | None = None
    jamming: Literal["none", "warning", "critical", "unknown"] = "unknown"
    spoofing: Literal["none", "indicated", "affirmed", "unknown"] = "unknown"
    raim: Literal["passed", "failed", "unknown"] = "unknown"
    fix_within_masks: Known = Field(
        "unknown", description="the fix keeps the receiver's own limits of dilution and accuracy"
    )
    authenticated: Known = Field(
        "unknown", description="the fix rests on authenticated navigation messages only"
    )
    expected_error_enu_m: Vector3 | None = Field(None, description="of the position, by RAIM")
    suspect_satellite: Name | None = Field(None, description="most likely to have failed: `G05`")
    suspect_bias_m: Annotated[float, Field(ge=-1e9, le=1e9)] | None = None
    suspect_bias_sigma_m: Sigma | None = None
    missed_detection_probability: Probability | None = None


class Fix(Message):
    """A tentative position: nothing may trust it before the judge has confirmed it. It is that of the antenna."""

    fix_id: Count
    origin: Literal["receiver", "engine"]
    quality: Quality
    latitude_rad: Latitude
    longitude_rad: Longitude
    height_m: Height = Field(description="ellipsoidal, of the antenna's reference point")
    covariance_enu_m2: Covariance3 | None = Field(
        description="as the receiver claims it; None: it does not say"
    )
    datum: Name = "WGS84"
    satellites: Annotated[int, Field(ge=0, le=255)] | None = None
    ratio: Sigma | None = None
    age_of_corrections_s: Sigma | None = None
    ambiguities_fixed: Count | None = None
    success_rate: Probability | None = None
    ambiguity_continuity: Literal["continuous", "broken", "no_evidence"] = "no_evidence"
    continuous_since_ns: TimeNs | None = Field(
        None, description="first fix of the chain whose integers go on to this one"
    )
    ambiguity_mode: AmbiguityMode = Field(
        "unknown",
        description="of the engine: each epoch by itself, or with ambiguities carried along unbroken arcs",
    )
    phase_residuals: Literal["consistent", "contradictory", "unknown"] = "unknown"
    base_station: Name | None = Field(
        None, description="on whose coordinate it rests; None: on none, or not reported"
    )
    subset_agreement: SubsetAgreement = Field(
        "unknown", description="of fixes from its satellites less one system; unknown: there is none"
    )


class SatelliteVelocity(Message):
    """Velocity and heading from Doppler, of the antenna."""

    velocity_enu_m_s: Vector3
    covariance_enu_m2_s2: Covariance3
    hdop: Sigma
    satellites: Annotated[int, Field(ge=0, le=255)]
    heading_rad: Angle | None = Field(None, description="clockwise from north")
    heading_sigma_rad: Sigma | None = None


class EstimatesRequest(Message):
    """The judge asks for other estimates of one fix; they are made and agreed on without any height."""

    fix_id: Count
    strategy: Literal[
        "leave_one_out", "leave_one_system_out", "by_cn0", "by_elevation", "by_residual", "explicit", "all"
    ] = "all"
    excluded_satellites: tuple[Name, ...] = Field((), max_length=100)
    maximum_trials: Annotated[int, Field(ge=1, le=1000)] = 20


class Candidate(Model):
    """One other estimate of a fix."""

    latitude_rad: Latitude
    longitude_rad: Longitude
    height_m: Height
    covariance_enu_m2: Covariance3
    excluded_satellites: tuple[Name, ...] = Field(max_length=100)
    ambiguities: Count
    ratio: Sigma
    success_rate: Probability
    agreeing_subsets: Count


class Estimates(Message):
    """All candidates, none chosen; `unavailable` where there are no raw observations (a receiver's own solution)."""

    fix_id: Count
    status: Literal["available", "unavailable", "forgotten"]
    reason: Text = ""
    trials: Count = 0
    candidates: tuple[Candidate, ...] = Field((), max_length=100)
