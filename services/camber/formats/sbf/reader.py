"""SBF decoder of a byte stream: observations, ephemerides, the receiver's position and its integrity reports.

Source: Septentrio mosaic-X5 reference guide, chapter "SBF Reference" (frame, blocks). No input raises: malformed
content is counted.
"""

from __future__ import annotations

import struct

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import BroadcastEphemeris
from camber.formats.receiver.frame_buffer import Frame, FramedDecoder
from camber.formats.receiver.integrity_report import IntegrityReport
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.sbf import pvt_reader as pvt
from camber.formats.sbf.block_time import block_time_ns
from camber.formats.sbf.ephemeris_blocks import NAVIGATION_BLOCKS
from camber.formats.sbf.integrity_blocks import read_authentication, read_radio_state
from camber.formats.sbf.measurement_reader import read_measurements
from camber.schemas.gnss import ReceiverIntegrity

SbfResult = ReceiverEpoch | BroadcastEphemeris | IonosphereCoefficients | ReceiverSolution | ReceiverIntegrity
MEAS_EPOCH, RF_STATUS, GAL_AUTH_STATUS = 4027, 4092, 4245
PVT_BLOCKS = (pvt.PVT_GEODETIC, pvt.POS_COV_GEODETIC, pvt.VEL_COV_GEODETIC, pvt.END_OF_PVT)
"""Those of one epoch's position, up to its end."""
_READ = {MEAS_EPOCH, RF_STATUS, GAL_AUTH_STATUS, *PVT_BLOCKS, *NAVIGATION_BLOCKS}
_HEADER_BYTES = 8  # mosaic-X5 reference guide, "SBF Block Header Format"


def block_number(frame: bytes) -> int:
    """Return the number of a block, without its revision."""
    return int.from_bytes(frame[4:6], "little") & 0x1FFF


class SbfMessages:
    """Decodes whole blocks; `SbfDecoder` decodes a stream.

    Every block contains its GPS time with the full week. The PVT blocks of one time become one position and one report
    of integrity with EndOfPVT, which should be enabled; without it when the next epoch begins, one epoch late. RFStatus
    and GALAuthStatus after EndOfPVT become a separate report.
    """

    def __init__(self, report: IntegrityReport | None = None) -> None:
        self.malformed = 0
        """Blocks whose content is inconsistent or truncated."""
        self.not_read = 0
        """Blocks of other kinds."""
        self.without_time = 0
        """Blocks before the receiver knows the time."""
        self.other_systems = 0
        """Measurements of SBAS, NavIC, L-band."""
        self.other_antennas = 0
        """Measurements of a second antenna."""
        self.unknown_signals = 0
        """Measurements of a signal that the satellite's system does not have."""
        self.repeated_signals = 0
        """Measurements of a signal that is already in the epoch."""
        self.epochs_without_position = 0
        """Epochs for which the receiver reports no position, or none in three dimensions."""
        self.late = 0
        """PVT blocks of an epoch after its end."""
        self.has_positions = False
        """Whether the receiver sends PVTGeodetic."""
        self._report = IntegrityReport() if report is None else report
        self._locks = LossOfLockDetector()
        self._clock_jumps: int | None = None
        self._epoch: pvt.PvtEpoch | None = None
        self._ended_ns: int | None = None
        self._signals_used: int | None = None
        self._report_changed = False

    def take(self, frame: bytes) -> list[SbfResult]:
        """Return the results that one frame with a correct checksum completes."""
        number, body = block_number(frame), frame[_HEADER_BYTES:]
        if number not in _READ:
            self.not_read += 1
            return []
        try:
            time_ns = block_time_ns(body)
            if time_ns is None:
                self.without_time += 1
                return []
            if number == MEAS_EPOCH:
                return self._measurements(body, time_ns)
            if number in PVT_BLOCKS:
                return self._pvt(number, body, time_ns)
            if number in NAVIGATION_BLOCKS:
                return [NAVIGATION_BLOCKS[number](body, time_ns)]
            return self._signal_state(number, body, time_ns)
        except (ValueError, struct.error):
            self.malformed += 1
            return []

    def finish(self) -> list[SbfResult]:
        """Return the results of the pending epoch, at the end of the stream."""
        return self._end_epoch()

    def _measurements(self, body: bytes, time_ns: int) -> list[SbfResult]:
        epoch, omitted, self._clock_jumps = read_measurements(body, time_ns, self._locks, self._clock_jumps)
        self.other_systems += omitted.other_systems
        self.other_antennas += omitted.other_antennas
        self.unknown_signals += omitted.unknown_signals
        self.repeated_signals += omitted.repeated
        return [epoch]

    def _signal_state(self, number: int, body: bytes, time_ns: int) -> list[SbfResult]:
        if number == RF_STATUS:
            self._report.update("radio", time_ns, read_radio_state(body))
        else:
            self._report.update("authentication", time_ns, read_authentication(body, self._signals_used))
        self._report_changed = True
        # Within an epoch the report is returned at its end.
        return [] if self._epoch is not None else self._integrity_report(time_ns)

    def _pvt(self, number: int, body: bytes, time_ns: int) -> list[SbfResult]:
        if self._epoch is None and time_ns == self._ended_ns:
            self.late += 1
            return []
        results = list[SbfResult]()
        if self._epoch is None or self._epoch.time_ns != time_ns:
            results = self._end_epoch()
            self._epoch = pvt.PvtEpoch(time_ns)
        if number == pvt.END_OF_PVT:
            return results + self._end_epoch()
        self.has_positions |= number == pvt.PVT_GEODETIC
        try:
            self._epoch.take(number, body)
        except (ValueError, struct.error):
            self.malformed += 1
        return results

    def _end_epoch(self) -> list[SbfResult]:
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return []
        self._ended_ns = epoch.time_ns
        self.epochs_without_position += epoch.lacks_position
        solution = epoch.solution()
        results: list[SbfResult] = [] if solution is None else [solution]
        self._signals_used = None if solution is None else epoch.signals_used
        if epoch.raim is not None:
            self._report.update("fix", epoch.time_ns, {"raim": epoch.raim})
        if self._report_changed or epoch.raim is not None:
            results += self._integrity_report(epoch.time_ns)
        return results

    def _integrity_report(self, time_ns: int) -> list[SbfResult]:
        self._report_changed = False
        return [*self._report.at(time_ns)]


class SbfDecoder(FramedDecoder[SbfResult]):
    """Decodes a stream."""

    def __init__(self, source_name: str) -> None:
        super().__init__("sbf")
        self.source_name = source_name
        self.messages = SbfMessages()
        """With the counters of the blocks."""

    def _take(self, frame: Frame) -> list[SbfResult]:
        return self.messages.take(frame.data)

    def _end(self) -> list[SbfResult]:
        return self.messages.finish()
