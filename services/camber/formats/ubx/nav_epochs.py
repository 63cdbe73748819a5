"""NAV messages combined by epoch: one position, one baseline, one integrity report per `iTOW`."""

from __future__ import annotations

from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.ubx import nav_reader as nav
from camber.formats.ubx.gps_week import navigation_time_ns, resolve_week_rollover
from camber.geodesy.covariance import EnuCovariance


class NavigationEpoch:
    """The messages received so far with one `iTOW`."""

    def __init__(self, of_week_ms: int) -> None:
        self.of_week_ms = of_week_ms
        self.pvt: nav.PositionVelocityTime | None = None
        self.protection: nav.ProtectionLevels | None = None
        self.baseline: nav.ReceiverBaseline | None = None
        """Its time is not set yet."""
        self._high_precision: nav.NavPosition | None = None
        self._covariances = nav.Covariances(None, None)

    def take(self, message_id: int, payload: bytes) -> None:
        """Decode one message of this epoch; ValueError where it is malformed."""
        if message_id == nav.PVT:
            self.pvt = nav.read_position_velocity_time(payload)
        elif message_id == nav.HPPOSLLH:
            self._high_precision = nav.read_high_precision_position(payload)
        elif message_id == nav.COV:
            self._covariances = nav.read_covariances(payload)
        elif message_id == nav.PL:
            self.protection = nav.read_protection_levels(payload)
        else:
            self.baseline = nav.read_baseline(payload)

    def time_ns(self, near_ns: int | None, reference_ns: int | None) -> int | None:
        """Return the time to ms, with NAV-PVT to ns; None where the week is unknown. ValueError for impossible times.

        Without a date the week is nearest to `near_ns`; a date may be wrong by whole roll-overs, which `reference_ns`
        resolves.
        """
        if self.pvt is not None and self.pvt.near_ns is not None:
            near_ns = resolve_week_rollover(self.pvt.near_ns, reference_ns)
        if near_ns is None:
            return None
        return navigation_time_ns(self.of_week_ms, near_ns, self.pvt.nanosecond if self.pvt else None)

    @property
    def lacks_position(self) -> bool:
        """Whether the receiver has no valid position, or reports one without NAV-PVT, which contains its quality."""
        return self._high_precision is not None if self.pvt is None else self.pvt.quality is None

    def solution(self, time_ns: int) -> ReceiverSolution | None:
        """Return the position with the highest precision received; its covariance from NAV-COV or the accuracies.

        `hAcc` is √(σ_e² + σ_n²) (checked against NAV-COV in recordings): without NAV-COV, σ_e and σ_n are assumed equal
        and uncorrelated, and the velocity's covariance is unknown.
        """
        pvt = self.pvt
        if pvt is None or pvt.quality is None:
            return None
        position = pvt.position if self._high_precision is None else self._high_precision
        return ReceiverSolution(
            time_ns=time_ns,
            latitude_rad=position.latitude_rad,
            longitude_rad=position.longitude_rad,
            height_m=position.height_m,
            quality=pvt.quality,
            satellites=pvt.satellites,
            covariance_enu_m2=self._covariances.position_m2 or _covariance_from_accuracies(position),
            age_s=pvt.age_s,
            velocity_enu_m_s=pvt.velocity_enu_m_s,
            velocity_covariance_enu_m2_s2=self._covariances.velocity_m2_s2,
        )


def _covariance_from_accuracies(position: nav.NavPosition) -> EnuCovariance | None:
    if position.horizontal_m is None or position.vertical_m is None:
        return None
    axis = 0.5 * position.horizontal_m * position.horizontal_m
    return axis, 0.0, 0.0, axis, 0.0, position.vertical_m * position.vertical_m
