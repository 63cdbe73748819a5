"""`camber upload FILE…`: send observations of road heights to the fleet's store and print the result for each file.

A FILE is CSV with one observation a row, as `camber uploads STORE --records` writes it:

    vehicle,id,datum,map_version,epoch_year,time_ns,fix_id,fix_quality,surface_id,verdict,latitude_rad,longitude_rad,
    horizontal_sigma_m,road_height_m,road_height_sigma_m,antenna_height_m

Nothing is sent before all rows of all files have been checked. Consecutive rows with the same id are one batch; without
ids the whole file is one. The store keeps each batch of a
vehicle once, so a file may be sent repeatedly: `stored` and `duplicate` both mean that it is committed.

    camber upload examples/uploads.csv --connect tcp/127.0.0.1:7448
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from camber.formats.drive.uploads_csv import CheckedUploads, check_uploads
from camber.formats.errors import FormatError
from camber.runtime.query import BusError, QueryClient, QueryFailed
from camber.schemas.fleet import UploadBatch, UploadReceipt
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS
from camber.tools.options.parsers import add_with_default, tool_parser

_PROG = "camber upload"
_HELP = "exit codes: 0 all stored; 1 a batch refused or not acknowledged; 2 invalid file or setting"
_MOST_REASONS = 5  # chosen: more of one file are alike
_RETRY_S = 0.5  # chosen: a few retries within the time of a restart of the store


def main(argv: Sequence[str] | None = None) -> int:
    """Check all files, then send them in order; return the exit code."""
    parser = tool_parser(_PROG, __doc__, _HELP, allow_abbrev=False)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    add_bus_options(parser)
    add_with_default(parser, "--timeout", 30.0, "time limit for each batch", type=SECONDS, metavar="S")
    args = parser.parse_args(argv)
    settings = bus_settings(args, prog=_PROG, vehicle=None)
    try:
        files = [check_uploads(path) for path in args.files]
        with QueryClient(settings, timeout_s=min(args.timeout, 5.0)) as client:
            done = [_send(client, file, args.timeout) for file in files]
    except (FormatError, OSError) as error:
        text = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else error
        print(f"{_PROG}: {text}", file=sys.stderr)
        return 2
    except BusError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 1
    return 0 if all(done) else 1


def _send(client: QueryClient, file: CheckedUploads, limit_s: float) -> bool:
    """Send the batches of a file, print counts by status, and return whether all are acknowledged."""
    path = file.path
    counts: Counter[str] = Counter()
    reasons: list[str] = []
    done = failed = 0
    try:
        for batch in file.batches():
            status, reason = _receipt(client, batch, limit_s)
            counts[status] += len(batch.fix_id)
            failed += bool(reason)
            if reason and len(reasons) < _MOST_REASONS:
                reasons.append(f"{batch.vehicle} {batch.batch_id}: {reason}")
            done += 1
    finally:  # also when interrupted: acknowledged batches are stored
        text = ", ".join(f"{n} {status}" for status, n in sorted(counts.items()))
        of_all = done if done == file.batch_count else f"{done} of {file.batch_count}"
        print(
            f"{path}: {sum(counts.values())} observations in {of_all} batches: {text or 'none'}", flush=True
        )
    for reason in reasons:
        print(f"{path}: {reason}", file=sys.stderr)
    return not failed


def _receipt(client: QueryClient, batch: UploadBatch, limit_s: float) -> tuple[str, str]:
    """Send a batch until a receipt arrives; return its status, and the reason where it is not stored."""
    deadline = time.monotonic() + limit_s
    while True:
        (replies,) = client.ask("upload_batch", batch, batch.vehicle, ["map_update"]).values()
        receipts = [r for r in replies if isinstance(r, UploadReceipt) and r.upload_id == batch.batch_id]
        if receipts:
            # Several workers may reply; a batch that one has stored is stored.
            receipt = min(receipts, key=lambda each: ("stored", "duplicate", "refused").index(each.status))
            return receipt.status, f"refused: {receipt.reason}" if receipt.status == "refused" else ""
        if time.monotonic() > deadline:
            failed = [str(reply) for reply in replies if isinstance(reply, QueryFailed)]
            return "not acknowledged", f"not acknowledged: {'; '.join(failed) or 'a receipt for another'}"
        time.sleep(_RETRY_S)
