"""A base station against what is remembered of it: whether it moved, its offset over days, what is new to remember."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.base_coordinate_history import BaseMemory
from camber.gnss.observations.base_station import BaseStation, station_name
from camber.gnss.observations.receiver_streams import StationPosition

_REMEMBER_EVERY_NS = 600 * NS_PER_SECOND  # chosen: the length of a window of `OffsetWindow`


class BaseWatch:
    """Compares a station with the memory when it states its coordinate, and adds to the memory while it is used.

    `mount` is the stream's address, because station numbers repeat; `confirmed` are the names (`station_name`) of
    coordinates that an operator accepts in place of the remembered one.
    """

    def __init__(
        self, memory: BaseMemory | None = None, mount: str = "", confirmed: Iterable[str] = ()
    ) -> None:
        self.memory = memory if memory is not None else BaseMemory()
        self._mount, self._confirmed = mount, frozenset(confirmed)
        self._stated: StationPosition | None = None
        self._station: str | None = None  # None: it is not to be remembered
        self._remembered_ns: int | None = None

    def station_stated(self, base: BaseStation, station: StationPosition, *, is_given: bool = False) -> None:
        """Compare the base, already at its new coordinate, with the memory; a given coordinate is confirmed."""
        position = base.position_ecef_m
        assert position is not None
        if station == self._stated:
            return
        name = station_name(station.label, position)
        self._stated, self._station, self._remembered_ns, base.name = station, station.label, None, name
        base.move = base.offset_over_days = None
        if station.is_virtual or not np.isfinite(position).all():
            self._station = None
            return
        base.move = self.memory.compare(self._mount, station.label, position)
        if base.move is not None and (is_given or name in self._confirmed):
            self.memory.forget(self._mount, station.label, position)
            base.move = None
        if base.move is None:
            base.offset_over_days = self.memory.offset(self._mount, station.label, position)

    def remember(self, base: BaseStation) -> None:
        """Add the last minutes to the memory, every ten minutes, where they agree with the coordinate."""
        offset, position, epoch, station = base.offset, base.position_ecef_m, base.epoch, self._station
        if offset is None or position is None or epoch is None or station is None:
            return
        if base.move is not None or offset.is_wrong:
            return
        since_ns = None if self._remembered_ns is None else epoch.time_ns - self._remembered_ns
        if since_ns is not None and 0 <= since_ns < _REMEMBER_EVERY_NS:
            return
        self._remembered_ns = epoch.time_ns
        self.memory.remember(self._mount, station, position, time_ns=epoch.time_ns, offset=offset)
        base.offset_over_days = self.memory.offset(self._mount, station, position)
