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


@dataclass(frozen=True, slots=True, kw_only=True)
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
    Channel(
        name="receiver_bytes",
        key=_V + "vehicle/receiver_bytes",
        message=gnss.ReceiverBytes,
        producers=("vehicle",),
        consumers=("gnss",),
        rate_hz=10,
        max_age_s=2.0,
        delivery="small",
        note="native bytes, where the receiver is not attached to gnss itself: replays",
    ),
    Channel(
        name="motion",
        key=_V + "vehicle/motion",
        message=motion.Motion,
        producers=("vehicle",),
        consumers=("gnss", "localizer", "antenna_height", "integrity"),
        rate_hz=10,
        max_age_s=0.5,
        delivery="small",
    ),
    Channel(
        name="suspension",
        key=_V + "vehicle/suspension",
        message=motion.Suspension,
        producers=("vehicle",),
        consumers=("antenna_height",),
        rate_hz=10,
        max_age_s=0.5,
        delivery="small",
    ),
    Channel(
        name="ranging",
        key=_V + "vehicle/ranging",
        message=motion.Ranging,
        producers=("vehicle",),
        consumers=("antenna_height",),
        rate_hz=10,
        max_age_s=0.5,
        delivery="small",
    ),
    Channel(
        name="sweep",
        key=_V + "vehicle/sweep",
        message=lidar.Sweep,
        producers=("vehicle",),
        consumers=("localizer",),
        rate_hz=10,
        max_age_s=0.5,
        delivery="bulk",
    ),
    Channel(
        name="fix",
        key=_V + "gnss/fix",
        message=gnss.Fix,
        producers=("gnss",),
        consumers=("localizer", "integrity"),
        rate_hz=10,
        max_age_s=0.5,
        delivery="small",
    ),
    Channel(
        name="velocity",
        key=_V + "gnss/velocity",
        message=gnss.SatelliteVelocity,
        producers=("gnss",),
        consumers=("integrity",),
        rate_hz=10,
        max_age_s=0.5,
        delivery="small",
    ),
    Channel(
        name="observations",
        key=_V + "gnss/observations",
        message=gnss.Observations,
        producers=("gnss",),
        consumers=(),
        rate_hz=10,
        max_age_s=None,
        delivery="small",
    ),
    Channel(
        name="receiver_integrity",
        key=_V + "gnss/receiver_integrity",
        message=gnss.ReceiverIntegrity,
        producers=("gnss",),
        consumers=("integrity",),
        rate_hz=1,
        max_age_s=2.0,
        delivery="small",
    ),
    Channel(
        name="estimates",
        key=_V + "gnss/estimates",
        message=gnss.EstimatesRequest,
        producers=("integrity",),
        consumers=("gnss",),
        rate_hz=None,
        max_age_s=0.1,
        delivery="query",
        reply=gnss.Estimates,
    ),
    Channel(
        name="elevation",
        key=_V + "map_server/elevation",
        message=road.ElevationRequest,
        producers=("localizer",),
        consumers=("map_server",),
        rate_hz=10,
        max_age_s=0.1,
        delivery="query",
        reply=road.ElevationReply,
    ),
    Channel(
        name="links",
        key=_V + "map_server/links",
        message=road.LinksRequest,
        producers=("localizer",),
        consumers=("map_server",),
        rate_hz=0.1,
        max_age_s=0.5,
        delivery="query",
        reply=road.LinksReply,
    ),
    Channel(
        name="tile",
        key=_V + "map_server/tile",
        message=road.TileRequest,
        producers=("localizer",),
        consumers=("map_server",),
        rate_hz=0.1,
        max_age_s=2.0,
        delivery="query",
        reply=road.TileReply,
    ),
    Channel(
        name="pose",
        key=_V + "localizer/pose",
        message=pose.Pose,
        producers=("localizer",),
        consumers=("antenna_height", "integrity"),
        rate_hz=10,
        max_age_s=0.3,
        delivery="small",
    ),
    Channel(
        name="scan_match",
        key=_V + "localizer/match",
        message=pose.ScanMatch,
        producers=("localizer",),
        consumers=("antenna_height", "integrity"),
        rate_hz=10,
        max_age_s=0.5,
        delivery="small",
        made_from="sweep",
    ),
    Channel(
        name="antenna_height",
        key=_V + "antenna_height/height",
        message=antenna.AntennaHeight,
        producers=("antenna_height",),
        consumers=("integrity",),
        rate_hz=10,
        max_age_s=2.0,
        delivery="small",
    ),
    Channel(
        name="verdict",
        key=_V + "integrity/verdict",
        message=integrity.Verdict,
        producers=("integrity",),
        consumers=("localizer", "consumers"),
        rate_hz=10,
        max_age_s=1.0,
        delivery="small",
        looped=True,
        note="confirmed positions anchor the localizer's next pose",
    ),
    Channel(
        name="position",
        key=_V + "integrity/position",
        message=integrity.Position,
        producers=("integrity",),
        consumers=("consumers",),
        rate_hz=10,
        max_age_s=1.0,
        delivery="small",
    ),
    Channel(
        name="upload",
        key=_U + "upload",
        message=fleet.ElevationUpload,
        producers=("tools",),
        consumers=("map_update",),
        rate_hz=None,
        max_age_s=None,
        delivery="upload",
        reply=fleet.UploadReceipt,
    ),
    Channel(
        name="upload_batch",
        key=_U + "upload_batch",
        message=fleet.UploadBatch,
        producers=("integrity",),
        consumers=("map_update",),
        rate_hz=0.2,
        max_age_s=None,
        delivery="upload",
        reply=fleet.UploadReceipt,
    ),
    Channel(
        name="release",
        key=_F + "release",
        message=fleet.ReleaseHead,
        producers=("map_update",),
        consumers=("map_server",),
        rate_hz=None,
        max_age_s=None,
        delivery="small",
    ),
    Channel(
        name="map_root",
        key=_F + "map/root",
        message=fleet.MapRootRequest,
        producers=("map_server",),
        consumers=("map_update",),
        rate_hz=None,
        max_age_s=5.0,
        delivery="fetch",
        reply=fleet.MapRootReply,
        note="after a notice, and now and then: notices can be lost",
    ),
    Channel(
        name="map_blob",
        key=_F + "map/blob",
        message=fleet.MapBlobRequest,
        producers=("map_server",),
        consumers=("map_update",),
        rate_hz=None,
        max_age_s=5.0,
        delivery="fetch",
        reply=fleet.MapBlobReply,
        note="only what the asker lacks",
    ),
    Channel(
        name="health",
        key=_V + "{service}/health",
        message=health.HealthRequest,
        producers=("tools",),
        consumers=(*SERVICES, SENSORS),
        rate_hz=None,
        max_age_s=1.0,
        delivery="query",
        reply=health.Health,
        note="answered by the work loop",
    ),
    Channel(
        name="log_level",
        key=_V + "{service}/log_level",
        message=health.LogLevelRequest,
        producers=("tools",),
        consumers=SERVICES,
        rate_hz=None,
        max_age_s=1.0,
        delivery="query",
        reply=health.LogLevelReply,
        note="answered by the work loop; falls back by itself",
    ),
    Channel(
        name="tick",
        key=_V + "replay/tick/{service}",
        message=health.Tick,
        producers=(FEEDER,),
        consumers=SERVICES,
        rate_hz=None,
        max_age_s=None,
        delivery="barrier",
    ),
    Channel(
        name="done",
        key=_V + "replay/done/{service}",
        message=health.Done,
        producers=SERVICES,
        consumers=(*SERVICES, FEEDER),
        rate_hz=None,
        max_age_s=None,
        delivery="barrier",
    ),
)

BY_NAME: dict[str, Channel] = {channel.name: channel for channel in CHANNELS}


def inputs_of(service: str) -> tuple[Channel, ...]:
    """Channels a service subscribes to (queries and the barrier apart)."""
    return tuple(c for c in CHANNELS if service in c.consumers and c.delivery in ("small", "bulk"))


def outputs_of(service: str) -> tuple[Channel, ...]:
    """Channels a service publishes on (queries and the barrier apart)."""
    speaks_as = "vehicle" if service == SENSORS else service
    return tuple(c for c in CHANNELS if speaks_as in c.producers and c.delivery in ("small", "bulk"))
