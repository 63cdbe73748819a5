"""THE table: every channel, who produces and consumes it, how often, how old it may be, how it is delivered.

Freshness limits, delivery settings, subscriptions, the order of work in a replay and `docs/data-flow.md` follow
from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
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
    late_s: tuple[tuple[str, float], ...] = ()
    """Consumers that need each message, by its date, and how old it may be there instead."""

    def received_by(self, service: str) -> Channel:
        """The channel as a consumer judges ages on it."""
        return replace(self, max_age_s=dict(self.late_s).get(service, self.max_age_s))

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


VEHICLE_SERVICES = ("gnss", "map_server", "localizer", "antenna_height", "integrity")
FEEDER = "feeder"
SERVICES = (*VEHICLE_SERVICES, "map_update")
"""In the order of work within one epoch of a replay."""
SENSORS = "sensors"
"""Publishes for the vehicle where no other process does; in a replay its part is the feeder's."""
ROS2 = "ros2"
"""As `sensors` for what comes from ROS; a consumer as any other."""
_ALL = " ".join(SERVICES)


_NAMES = {
    "localizer/match": "scan_match",
    "localizer/match_points": "scan_match_points",
    "antenna_height/height": "antenna_height",
    "fleet/map/root": "map_root",
    "fleet/map/blob": "map_blob",
    "fleet/map/changes": "map_changes",
    "fleet/map/votes": "map_votes",
    "fleet/map/decision": "map_decision",
    "replay/tick/{service}": "tick",
    "replay/done/{service}": "done",
}
"""Of those that are not called as the end of their key."""
_LATE_S = dict.fromkeys(("motion", "imu"), (("localizer", 5.0),))
"""Chosen: dead reckoning needs every sample, also after the localizer itself was busy for some seconds; a pose of an
old sample is dated, so its consumers refuse it."""
_NOTES = {
    "receiver_bytes": "native bytes, where the receiver is not attached to gnss itself: replays",
    "pose": "with an inertial unit 50 Hz, one per 20 ms step of the unit",
    "verdict": "confirmed positions anchor the localizer's next pose",
    "scan_match_points": "only while somebody subscribes",
    "map_root": "after a notice, and now and then: notices can be lost",
    "map_blob": "only what the asker lacks",
    "map_decision": "signed by an operator's key; acknowledged after it is on the disk",
    "health": "answered by the work loop",
    "log_level": "answered by the work loop; falls back by itself",
}


def _row(
    key: str,
    flow: str,
    rate_and_age: tuple[float | None, float | None],
    message: type[Message] | tuple[type[Message], type[Message]],
    *,
    delivery: Delivery = "small",
    looped: bool = False,
    made_from: str = "",
) -> Channel:
    """A channel below the vehicle's key or the fleet's; `flow`: "producers > consumers"; a query's message: both."""
    name = _NAMES.get(key) or key.rpartition("/")[2]
    producers, _, consumers = flow.partition(">")
    rate_hz, max_age_s = rate_and_age
    return Channel(
        name=name,
        key=f"camber/v1/{key}" if key.startswith("fleet/") else f"camber/v1/{{vehicle}}/{key}",
        message=message[0] if isinstance(message, tuple) else message,
        reply=message[1] if isinstance(message, tuple) else None,
        producers=tuple(producers.split()),
        consumers=tuple(consumers.split()),
        rate_hz=rate_hz,
        max_age_s=max_age_s,
        delivery=delivery,
        looped=looped,
        made_from=made_from,
        note=_NOTES.get(name, ""),
        late_s=_LATE_S.get(name, ()),
    )


_bulk, _query = partial(_row, delivery="bulk"), partial(_row, delivery="query")
_upload, _fetch = partial(_row, delivery="upload"), partial(_row, delivery="fetch")
_barrier = partial(_row, delivery="barrier")
CHANNELS: tuple[Channel, ...] = (
    _row("vehicle/receiver_bytes", "vehicle > gnss", (10, 2.0), gnss.ReceiverBytes),
    _row("vehicle/motion", "vehicle > gnss localizer antenna_height integrity", (10, 0.5), motion.Motion),
    _row("vehicle/imu", "vehicle > localizer", (200, 0.5), motion.Imu),
    _row("vehicle/suspension", "vehicle > antenna_height", (10, 0.5), motion.Suspension),
    _row("vehicle/ranging", "vehicle > antenna_height", (10, 0.5), motion.Ranging),
    _bulk("vehicle/sweep", "vehicle > localizer", (10, 0.5), lidar.Sweep),
    _row("gnss/fix", "gnss > localizer integrity", (10, 0.5), gnss.Fix),
    _row("gnss/velocity", "gnss > integrity", (10, 0.5), gnss.SatelliteVelocity),
    _row("gnss/observations", "gnss >", (10, None), gnss.Observations),
    _row("gnss/satellites", "gnss >", (1, None), gnss.SatellitesInView),
    _row("gnss/receiver_integrity", "gnss > integrity", (1, 2.0), gnss.ReceiverIntegrity),
    _query("gnss/estimates", "integrity > gnss", (None, 0.1), (gnss.EstimatesRequest, gnss.Estimates)),
    _query(
        "map_server/elevation",
        "localizer > map_server",
        (10, 0.1),
        (road.ElevationRequest, road.ElevationReply),
    ),
    _query("map_server/links", "localizer > map_server", (0.1, 0.5), (road.LinksRequest, road.LinksReply)),
    _query("map_server/tile", "localizer > map_server", (0.1, 2.0), (road.TileRequest, road.TileReply)),
    _row("localizer/pose", "localizer > antenna_height integrity", (10, 0.3), pose.Pose),
    _row(
        "localizer/match",
        "localizer > antenna_height integrity",
        (10, 0.5),
        pose.ScanMatch,
        made_from="sweep",
    ),
    _bulk("localizer/match_points", "localizer >", (1, None), pose.ScanMatchPoints, made_from="sweep"),
    _row("antenna_height/height", "antenna_height > integrity", (10, 2.0), antenna.AntennaHeight),
    _row("integrity/verdict", "integrity > localizer consumers", (10, 1.0), integrity.Verdict, looped=True),
    _row("integrity/position", "integrity > consumers", (10, 1.0), integrity.Position),
    _upload(
        "fleet/{vehicle}/upload",
        "tools > map_update",
        (None, None),
        (fleet.ElevationUpload, fleet.UploadReceipt),
    ),
    _upload(
        "fleet/{vehicle}/upload_batch",
        "integrity > map_update",
        (0.2, None),
        (fleet.UploadBatch, fleet.UploadReceipt),
    ),
    _row("fleet/release", "map_update > map_server", (None, None), fleet.ReleaseHead),
    _fetch(
        "fleet/map/root", "map_server > map_update", (None, 5.0), (fleet.MapRootRequest, fleet.MapRootReply)
    ),
    _fetch(
        "fleet/map/blob", "map_server > map_update", (None, 5.0), (fleet.MapBlobRequest, fleet.MapBlobReply)
    ),
    _query(
        "fleet/map/changes", "tools > map_update", (None, 2.0), (fleet.MapChangesRequest, fleet.MapChanges)
    ),
    _query("fleet/map/votes", "tools > map_update", (None, 2.0), (fleet.MapVotesRequest, fleet.MapVotes)),
    _query(
        "fleet/map/decision", "tools > map_update", (None, 5.0), (fleet.MapDecision, fleet.MapDecisionReceipt)
    ),
    _query(
        "{service}/health",
        f"tools > {_ALL} {SENSORS} {ROS2}",
        (None, 1.0),
        (health.HealthRequest, health.Health),
    ),
    _query(
        "{service}/log_level", f"tools > {_ALL}", (None, 1.0), (health.LogLevelRequest, health.LogLevelReply)
    ),
    _barrier("replay/tick/{service}", f"feeder > {_ALL}", (None, None), health.Tick),
    _barrier("replay/done/{service}", f"{_ALL} > {_ALL} {FEEDER}", (None, None), health.Done),
)

BY_NAME: dict[str, Channel] = {channel.name: channel for channel in CHANNELS}


def inputs_of(service: str) -> tuple[Channel, ...]:
    """Channels a service subscribes to (queries and the barrier apart)."""
    receives_as = "consumers" if service == ROS2 else service
    return tuple(c for c in CHANNELS if receives_as in c.consumers and c.delivery in ("small", "bulk"))


def outputs_of(service: str) -> tuple[Channel, ...]:
    """Channels a service publishes on (queries and the barrier apart)."""
    speaks_as = "vehicle" if service in (SENSORS, ROS2) else service
    return tuple(c for c in CHANNELS if speaks_as in c.producers and c.delivery in ("small", "bulk"))
