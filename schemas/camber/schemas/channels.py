"""THE table: every channel, who produces and consumes it, how often, how old it may be, how it is delivered.

Freshness limits, delivery settings, subscriptions, the order of work in a replay and `docs/data-flow.md` follow
from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from camber.schemas import antenna, fleet, gnss, health, integrity, lidar, motion, pose, road
from camber.schemas.base import Message

Delivery = Literal["small", "bulk", "query", "upload", "fetch", "barrier"]
"""small: reliable, dropped when congested, high priority, judged by age. bulk: low priority, newest only.
query: query and reply, at most 256 kB a reply, explicit timeout. upload: durable outbox, acknowledged after commit,
deduplicated. fetch: query and reply at low priority, at most 256 kB a reply, asked again until it comes. barrier:
reliable, blocking, in replays only."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One row. For a query, `message` is the request, `reply` the answer; the producer asks, consumers answer."""

    name: str
    key: str
    message: type[Message]
    producers: tuple[str, ...]
    consumers: tuple[str, ...]
    rate_hz: float | None
    max_age_s: float | None
    delivery: Delivery
    reply: type[Message] | None = None
    looped: bool = False  # consumed one epoch later: the loops that the documents ask for
    made_from: str = ""  # the vehicle's channel without which there is nothing on this one
    note: str = ""

    def key_for(self, vehicle: str) -> str:
        """The Zenoh key of this channel for one vehicle."""
        return self.key.replace("{vehicle}", vehicle)

    def answered_at(self, vehicle: str) -> str:
        """The key under which questions are answered: one service answers the uploads of all vehicles."""
        return self.key_for("*" if self.delivery == "upload" else vehicle)

    def vehicle_in(self, key: str) -> str:
        """The vehicle that a key of this channel names; ValueError for any other key, and for one that names many."""
        before, _, after = self.key.partition("{vehicle}")
        vehicle = key.removeprefix(before).removesuffix(after)
        if key != f"{before}{vehicle}{after}" or not vehicle or set(vehicle) & set("/*$"):
            raise ValueError(f"key {key[:200]!r}: expected {self.key} of one vehicle")
        return vehicle


_V = "camber/v1/{vehicle}/"
_F = "camber/v1/fleet/"
_U = _F + "{vehicle}/"  # the vehicle that uploads: access rules bind the key to its certificate
VEHICLE_SERVICES = ("gnss", "map_server", "localizer", "antenna_height", "integrity")
FEEDER = "feeder"
SERVICES = (*VEHICLE_SERVICES, "map_update")
"""In the order of work within one epoch of a replay."""
SENSORS = "sensors"
"""Speaks for the vehicle where no other process does; in a replay its part is the feeder's."""

CHANNELS: tuple[Channel, ...] = (
    Channel("receiver_bytes", _V + "vehicle/receiver_bytes", gnss.ReceiverBytes, ("vehicle",), ("gnss",), 10, 2.0,
            "small", note="native bytes, where the receiver is not attached to gnss itself: replays"),
    Channel("motion", _V + "vehicle/motion", motion.Motion, ("vehicle",),
            ("gnss", "localizer", "antenna_height", "integrity"), 10, 0.5, "small"),
    Channel("suspension", _V + "vehicle/suspension", motion.Suspension, ("vehicle",), ("antenna_height",), 10, 0.5,
            "small"),
    Channel("ranging", _V + "vehicle/ranging", motion.Ranging, ("vehicle",), ("antenna_height",), 10, 0.5, "small"),
    Channel("sweep", _V + "vehicle/sweep", lidar.Sweep, ("vehicle",), ("localizer",), 10, 0.5, "bulk"),
    Channel("fix", _V + "gnss/fix", gnss.Fix, ("gnss",), ("localizer", "integrity"), 10, 0.5, "small"),
    Channel("velocity", _V + "gnss/velocity", gnss.SatelliteVelocity, ("gnss",), ("integrity",), 10, 0.5, "small"),
    Channel("observations", _V + "gnss/observations", gnss.Observations, ("gnss",), (), 10, None, "small"),
    Channel("receiver_integrity", _V + "gnss/receiver_integrity", gnss.ReceiverIntegrity, ("gnss",), ("integrity",),
            1, 2.0, "small"),
    Channel("estimates", _V + "gnss/estimates", gnss.EstimatesRequest, ("integrity",), ("gnss",), None, 0.1, "query",
            reply=gnss.Estimates),
    Channel("elevation", _V + "map_server/elevation", road.ElevationRequest, ("localizer",), ("map_server",), 10, 0.1,
            "query", reply=road.ElevationReply),
    Channel("links", _V + "map_server/links", road.LinksRequest, ("localizer",), ("map_server",), 0.1, 0.5, "query",
            reply=road.LinksReply),
    Channel("tile", _V + "map_server/tile", road.TileRequest, ("localizer",), ("map_server",), 0.1, 2.0, "query",
            reply=road.TileReply),
    Channel("pose", _V + "localizer/pose", pose.Pose, ("localizer",), ("antenna_height", "integrity"), 10, 0.3,
            "small"),
    Channel("scan_match", _V + "localizer/match", pose.ScanMatch, ("localizer",), ("antenna_height", "integrity"), 10,
            0.5, "small", made_from="sweep"),
    Channel("antenna_height", _V + "antenna_height/height", antenna.AntennaHeight, ("antenna_height",), ("integrity",),
            10, 2.0, "small"),
    Channel("verdict", _V + "integrity/verdict", integrity.Verdict, ("integrity",), ("localizer", "consumers"), 10, 1.0,
            "small", looped=True, note="confirmed positions anchor the localizer's next pose"),
    Channel("position", _V + "integrity/position", integrity.Position, ("integrity",), ("consumers",), 10, 1.0,
            "small"),
    Channel("upload", _U + "upload", fleet.ElevationUpload, ("tools",), ("map_update",), None, None, "upload",
            reply=fleet.UploadReceipt),
    Channel("upload_batch", _U + "upload_batch", fleet.UploadBatch, ("integrity",), ("map_update",), 0.2, None,
            "upload", reply=fleet.UploadReceipt),
    Channel("release", _F + "release", fleet.ReleaseHead, ("map_update",), ("map_server",), None, None, "small"),
    Channel("map_root", _F + "map/root", fleet.MapRootRequest, ("map_server",), ("map_update",), None, 5.0, "fetch",
            reply=fleet.MapRootReply, note="after a notice, and now and then: notices can be lost"),
    Channel("map_blob", _F + "map/blob", fleet.MapBlobRequest, ("map_server",), ("map_update",), None, 5.0, "fetch",
            reply=fleet.MapBlobReply, note="only what the asker lacks"),
    Channel("health", _V + "{service}/health", health.HealthRequest, ("tools",), (*SERVICES, SENSORS), None, 1.0,
            "query", reply=health.Health, note="answered by the work loop"),
    Channel("log_level", _V + "{service}/log_level", health.LogLevelRequest, ("tools",), SERVICES, None, 1.0, "query",
            reply=health.LogLevelReply, note="answered by the work loop; falls back by itself"),
    Channel("tick", _V + "replay/tick/{service}", health.Tick, (FEEDER,), SERVICES, None, None, "barrier"),
    Channel("done", _V + "replay/done/{service}", health.Done, SERVICES, (*SERVICES, FEEDER), None, None, "barrier"),
)  # fmt: skip

BY_NAME: dict[str, Channel] = {channel.name: channel for channel in CHANNELS}


def inputs_of(service: str) -> tuple[Channel, ...]:
    """Channels a service subscribes to (queries and the barrier apart)."""
    return tuple(c for c in CHANNELS if service in c.consumers and c.delivery in ("small", "bulk"))


def outputs_of(service: str) -> tuple[Channel, ...]:
    """Channels a service publishes on (queries and the barrier apart)."""
    speaks_as = "vehicle" if service == SENSORS else service
    return tuple(c for c in CHANNELS if speaks_as in c.producers and c.delivery in ("small", "bulk"))
