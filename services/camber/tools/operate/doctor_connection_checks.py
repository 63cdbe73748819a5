"""Checks of a deployment's connections for `camber doctor`: bus, ports, map, receiver, corrections."""

from __future__ import annotations

import re
import socket
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.formats.receiver.mixed_stream import MixedDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.geodesy.gps_time import NS_PER_DAY
from camber.road_map.release import ReleaseError, load_signing_key, open_release
from camber.runtime.access_probe import can_publish, denial_message
from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient
from camber.runtime.settings import ServiceSettings
from camber.runtime.tls_certificates import TlsError
from camber.tools.operate.doctor_machine_checks import Finding, not_checked, ok, problem
from camber.transport.byte_streams import ByteStream, open_stream
from camber.transport.ntrip_client import NtripAccess

_REACH_S, _VERIFY_S = 3.0, 20.0
"""Chosen: an operator waits for the result; a router on a slow uplink answers within a second."""
# A receiver's message arrives some tenths of a second after its epoch and never before it (measured on receiver logs).
MOST_LATENCY_S, MOST_AHEAD_S = 0.5, 0.05


def check_bus(settings: ServiceSettings) -> Iterator[Finding]:
    """Check that a router answers at the endpoints of a service, and that access rules allow us to publish."""
    zenoh = settings.zenoh
    for endpoint in zenoh.connect:
        what = f"bus {endpoint}"
        host = re.fullmatch(r"(?:tcp|tls)/(.+):(\d+)(?:[?#].*)?", endpoint)
        if host is None:
            yield not_checked(what, "only tcp/ and tls/ endpoints can be checked")
            continue
        try:
            socket.create_connection(_address(host[1], host[2]), timeout=_REACH_S).close()
            yield ok(what, "a server listens")
        except OSError as error:
            yield problem(what, f"{error.strerror or error}", "start the router, or correct its address")
    try:
        with QueryClient(settings, timeout_s=_REACH_S) as client:
            alive = client.alive(settings.vehicle).get(settings.vehicle, frozenset())
        yield ok("bus", f"joined; services of {settings.vehicle}: {', '.join(sorted(alive)) or 'none yet'}")
        if zenoh.over_tls and can_publish(zenoh, settings.vehicle, timeout_s=_REACH_S) == "denied":
            text = denial_message(zenoh, settings.vehicle)
            yield problem("bus, access", text, "run `camber access cloud` again")
    except (BusError, TlsError) as error:
        yield problem("bus", str(error), "router, certificates; `camber health router`")


def check_ports(all_settings: Sequence[tuple[str, ServiceSettings]]) -> Iterator[Finding]:
    """Check that each port is free, or in use by that service already, and assigned once."""
    wanted: dict[tuple[str, int], str] = {}
    for name, settings in all_settings:
        ports = [] if settings.metrics_port is None else [(settings.metrics_host, settings.metrics_port)]
        if settings.zenoh.mode != "client":
            matches = (re.fullmatch(r"(?:tcp|tls)/(.+):(\d+)", each) for each in settings.zenoh.listen)
            ports += [(match[1].strip("[]"), int(match[2])) for match in matches if match is not None]
        for host, port in ports:
            if port == 0:
                continue
            what = f"port {host}:{port} of {name}"
            others = [of for (place, used), of in wanted.items() if used == port and _overlap(place, host)]
            if others:
                yield problem(what, f"also assigned to {others[0]}", "a different port for each service")
                continue
            wanted[host, port] = name
            yield _check_port(what, host, port)


def _overlap(one: str, other: str) -> bool:
    """Whether two listen addresses cannot share a port: `::` is every address, 0.0.0.0 every IPv4 address."""
    return one == other or "::" in (one, other) or ("0.0.0.0" in (one, other) and ":" not in one + other)


def _address(host: str, port: str | int) -> tuple[str, int]:
    """Return the address for a socket; OSError where host or port is invalid."""
    host, number = host.strip("[]"), int(port)
    try:
        host.encode("idna")
    except UnicodeError:
        raise OSError(f"{host} is not a valid host name") from None
    if number > 65_535:
        raise OSError(f"port {number}: expected at most 65535")
    return host, number


def _check_port(what: str, host: str, port: int) -> Finding:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.create_server(_address(host, port), family=family):
            return ok(what, "free")
    except OSError as error:
        if _is_ours(host, port):
            return ok(what, "in use by a running service of Camber")
        remedy = "another port, or stop the program that uses it (`ss -ltnp`)"
        return problem(what, f"{error.strerror or error}", remedy)


def _is_ours(host: str, port: int) -> bool:
    try:
        with socket.create_connection(_address(host, port), timeout=1.0) as connection:
            connection.sendall(b"GET /metrics HTTP/1.1\r\n\r\n")
            connection.settimeout(2.0)
            return b"camber_" in connection.recv(65536)
    except OSError:
        return False


def check_map(settings: Any, datum_of_fixes: str | None) -> Iterator[Finding]:
    """Check that the release opens, carries the trusted signature, has the datum of the fixes and can be read."""
    if settings.store is not None and settings.public_key is None and not settings.unsigned:
        text = f"without public_key no newer release is fetched into {settings.store}"
        remedy = "set public_key of map_server to the public half of the signing key"
        yield problem("map, signature", text, remedy)
    if settings.release is None:
        text = f"map_server fetches it into {settings.store}; `camber status` shows which it uses"
        yield not_checked("map", text)
        return
    try:
        key = settings.trusted_key(SystemClock().now_ns)
        release = open_release(settings.release, public_key=key)
    except ReleaseError as error:
        yield problem(
            "map", str(error), "`camber map inspect`; a complete release and the key that signed it"
        )
        return
    manifest = release.manifest
    signature = "signature not checked (no public_key)" if key is None else f"signed by {settings.public_key}"
    yield ok("map", f"{settings.release}: {manifest.region}, version {manifest.map_version}, {signature}")
    yield from _check_datums(manifest.datum, settings.datum, datum_of_fixes)
    age_ns = SystemClock().now_ns() - manifest.time_ns
    if settings.max_age_days is not None and not -NS_PER_DAY <= age_ns <= settings.max_age_days * NS_PER_DAY:
        text = f"{age_ns / NS_PER_DAY:.0f} days old, expected at most {settings.max_age_days:g}"
        yield problem("map, age", text, "a newer release, or another max_age_days")
    if manifest.surrogate:
        text = f"a surrogate: {manifest.surrogate}"
        yield problem("map, origin", text, "a surveyed map for a real vehicle")
    yield _check_tiles(release)


def check_reference(settings: Any) -> Iterator[Finding]:
    """Check the reference from which map_update makes releases, and the signing key."""
    if settings.reference is None:
        if settings.role != "receive":
            yield not_checked("reference", "map_update has none: uploads are stored, no release is made")
        return
    try:
        manifest = open_release(settings.reference).manifest
        if settings.signing_key is not None:
            load_signing_key(settings.signing_key)
    except ReleaseError as error:
        yield problem("reference", str(error), "reference and signing_key of map_update")
        return
    signed = "signed" if settings.signing_key else "not signed: vehicles with a public_key refuse them"
    yield ok("reference", f"{settings.reference}: {manifest.region}; its releases will be {signed}")


def _check_datums(of_map: str, of_server: str, of_fixes: str | None) -> Iterator[Finding]:
    for name, datum in (("map_server.toml", of_server), ("gnss.toml", of_fixes)):
        if datum is not None and datum != of_map:
            remedy = "the datum of the corrections, and a map in the same (`camber map build --datum`)"
            yield problem("datum", f"map {of_map}, {name} {datum}: every verdict will be unknown", remedy)
            return
    yield ok("datum", f"{of_map}, as of fixes and map_server" if of_fixes else f"{of_map}, as of map_server")


def _check_tiles(release: Any) -> Finding:
    deadline_s, tiles, size = time.monotonic() + _VERIFY_S, 0, 0
    try:
        for tile_bytes in release.check():
            tiles, size = tiles + 1, size + tile_bytes
            if time.monotonic() > deadline_s:
                return ok("map, tiles", f"the first {tiles}, {size >> 20} MB, are intact")
    except ReleaseError as error:
        return problem("map, tiles", str(error), "copy the release again")
    return ok("map, tiles", f"all {tiles}, {size / 1e6:.1f} MB, are intact")


def check_receiver(settings: Any, seconds: float, *, gnss_runs: bool) -> Iterator[Finding]:
    """Check that receiver and corrections deliver current data in the protocol of the settings."""
    password = settings.ntrip_password
    access = NtripAccess(
        user=settings.ntrip_user,
        password=None if password is None else password.get_secret_value(),
        version=settings.ntrip_version,
        ca_file=settings.ntrip_ca_file,
    )
    over_bus = "its bytes arrive over the bus; `camber status` shows receiver_bytes"
    no_source = "no base_source: corrections go to the receiver or over the bus"
    for what, url, protocol, otherwise in (
        ("receiver", settings.source, settings.protocol, over_bus),
        ("corrections", settings.base_source, settings.base_protocol, no_source),
    ):
        if url in (None, "bus"):
            yield not_checked(what, otherwise)
        elif gnss_runs and url.startswith("serial:"):
            yield not_checked(what, f"the running gnss has opened {url}; see `camber status`")
        else:
            stream = open_stream(url, on_data=lambda: None, ntrip=access)
            yield from _check_stream(stream, what=what, url=url, protocol=protocol, seconds=seconds)


def _check_stream(
    stream: ByteStream, *, what: str, url: str, protocol: str, seconds: float
) -> Iterator[Finding]:
    """Read a stream for some seconds; of a receiver also compare the clocks."""
    with_time = what == "receiver"
    is_cable = url.startswith(("serial", "tcp", "file"))
    remedy = "cable, address, permissions of the device" if is_cable else "caster, mount point, user"
    clock = SystemClock()
    frames, decoder = FrameBuffer("ubx", "sbf", "nmea", "rtcm"), MixedDecoder("receiver", clock.now_ns())
    frame_counts: Counter[str] = Counter()
    latencies_s: list[float] = []
    size, deadline_s = 0, time.monotonic() + seconds
    try:
        while time.monotonic() < deadline_s:
            time.sleep(0.02)
            data = stream.take()
            now_ns = clock.now_ns()
            size += len(data)
            frame_counts.update(frame.protocol for frame in frames.feed(data))
            if with_time:
                solutions = [item for item in decoder.feed(data) if isinstance(item, ReceiverSolution)]
                latencies_s += [(now_ns - solution.time_ns) / 1e9 for solution in solutions]
    finally:
        stream.close()
    if not size:
        text = stream.last_failure if stream.failures else f"no data within {seconds:g} s"
        yield problem(what, f"{url}: {text}", remedy)
        return
    counts = ", ".join(f"{count} {name}" for name, count in frame_counts.most_common())
    if protocol in ("ubx", "sbf", "nmea", "rtcm", "mixed"):
        if not (frame_counts.total() if protocol == "mixed" else frame_counts[protocol]):
            text = f"{url}: {size} bytes without {protocol} ({counts or 'no frame of any protocol'})"
            yield problem(what, text, "protocol in gnss.toml, baud rate, output of the receiver")
            return
        if protocol != "mixed" and len(frame_counts) > 1:
            yield problem(what, f"{url}: {counts}, but only {protocol} is read", 'protocol = "mixed"')
            return
    yield ok(what, f"{url}: {size} bytes in {seconds:g} s{f', {counts}' if counts else ''}")
    if with_time:
        yield _check_clock_offset(latencies_s)


def _check_clock_offset(latencies_s: list[float]) -> Finding:
    """Compare the machine's clock with the receiver's by the smallest latency of a solution."""
    what = "clock against the receiver"
    if not latencies_s:
        return not_checked(what, "no position with a date was received")
    least_s = min(latencies_s)
    text = f"positions arrive {least_s:+.3f} s after their epoch"
    if -MOST_AHEAD_S <= least_s <= MOST_LATENCY_S:
        return ok(what, text)
    is_whole_second = abs(least_s) > 0.9 and abs(least_s - round(least_s)) < 0.3
    suspects = f"{'leap seconds or ' if is_whole_second else ''}the machine's clock (NTP, PTP)"
    return problem(what, text, f"{suspects}: fixes will be stale")
