"""NAV messages put together epoch by epoch: one position, one baseline, one statement of each `iTOW`."""

from __future__ import annotations

from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.ubx.gps_week import navigation_time_ns, resolve_week_rollover
from camber.formats.ubx.nav_reader import (
    COV,
    HPPOSLLH,
    PL,
    PVT,
    Covariances,
    NavPosition,
    PositionVelocityTime,
    ProtectionLevels,
    ReceiverBaseline,
    read_baseline,
    read_covariances,
    read_high_precision_position,
    read_position_velocity_time,
    read_protection_levels,
)
from camber.geodesy.covariance import EnuCovariance


class NavigationEpoch:
    """What has come of one `iTOW`."""

    def __init__(self, of_week_ms: int) -> None:
        self.of_week_ms = of_week_ms
        self.pvt: PositionVelocityTime | None = None
        self.protection: ProtectionLevels | None = None
        self.baseline: ReceiverBaseline | None = None
        """Its time is that of no epoch yet."""
        self._precise: NavPosition | None = None
        self._covariances = Covariances(None, None)

    def take(self, message_id: int, payload: bytes) -> None:
        """One of the messages of this epoch; ValueError where it is malformed."""
        if message_id == PVT:
            self.pvt = read_position_velocity_time(payload)
        elif message_id == HPPOSLLH:
            self._precise = read_high_precision_position(payload)
        elif message_id == COV:
            self._covariances = read_covariances(payload)
        elif message_id == PL:
            self.protection = read_protection_levels(payload)
        else:
            self.baseline = read_baseline(payload)

    def time_ns(self, near_ns: int | None, reference_ns: int | None) -> int | None:
        """To ms, with NAV-PVT to ns; None where the week is not known. ValueError for times that cannot be.

        Without a date the week is nearest to `near_ns`; a date may be roll-overs off, see `resolve_week_rollover`.
        """
        if self.pvt is not None and self.pvt.near_ns is not None:
            near_ns = resolve_week_rollover(self.pvt.near_ns, reference_ns)
        if near_ns is None:
            return None
        return navigation_time_ns(self.of_week_ms, near_ns, self.pvt.nanosecond if self.pvt else None)

    @property
    def lacks_position(self) -> bool:
        """The receiver has none that it vouches for, or sends one without NAV-PVT, which says what it is worth."""
        return self._precise is not None if self.pvt is None else self.pvt.quality is None

    def solution(self, time_ns: int) -> ReceiverSolution | None:
        """The position as precise as it was said; its covariance is NAV-COV's, else that of the accuracies.

        `hAcc` is √(σ_e² + σ_n²) (so it is beside NAV-COV in recordings): where there is nothing else both are taken for
        equal and uncorrelated, and the velocity's covariance is not known.
        """
        pvt = self.pvt
        if pvt is None or pvt.quality is None:
            return None
        place = pvt.place if self._precise is None else self._precise
        return ReceiverSolution(
            time_ns=time_ns,
            latitude_rad=place.latitude_rad,
            longitude_rad=place.longitude_rad,
            height_m=place.height_m,
            quality=pvt.quality,
            satellites=pvt.satellites,
            covariance_enu_m2=self._covariances.position_m2 or _from_accuracies(place),
            age_s=pvt.age_s,
            velocity_enu_m_s=pvt.velocity_enu_m_s,
            velocity_covariance_enu_m2_s2=self._covariances.velocity_m2_s2,
        )


def _from_accuracies(place: NavPosition) -> EnuCovariance | None:
    if place.horizontal_m is None or place.vertical_m is None:
        return None
    each = 0.5 * place.horizontal_m * place.horizontal_m
    return each, 0.0, 0.0, each, 0.0, place.vertical_m * place.vertical_m
