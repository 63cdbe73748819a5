"""`camber uploads STORE`: what the fleet's store holds, as CSV; it is only read.

STORE is the file uploads.sqlite, or the address of a database as for `camber map_update --store`; the password comes
from the environment, as there.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from camber.map_update.contribution import OBSERVATION, QUALITIES, VERDICTS
from camber.map_update.settings import MapUpdateSettings
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import LedgerEntry, ObservationPage, Store, StoreError
from camber.runtime.settings import ConfigError, load

_PROG = "camber uploads"
_AT_ONCE = 50_000


def main(argv: list[str] | None = None) -> int:
    """Returns 2 where the store cannot be read."""
    parser = argparse.ArgumentParser(
        prog=_PROG, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", metavar="STORE")
    parser.add_argument("--records", action="store_true", help="observations; without it: contributions")
    args = parser.parse_args(argv)
    try:
        with closing(_opened(args.store)) as store:
            out = csv.writer(sys.stdout, lineterminator="\n")
            out.writerow(
                [*LedgerEntry._fields, *((OBSERVATION.names or ()) if args.records else ("records",))]
            )
            for found in _all(store):
                out.writerows(_records(found) if args.records else _contributions(found))
            sys.stdout.flush()
    except (StoreError, ConfigError) as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    return 0


def _opened(where: str) -> Store:
    if "://" in where:
        from camber.map_update.stores.postgres_store import PostgresStore

        settings, _ = load(MapUpdateSettings, [f"--store={where}"], prog=_PROG)
        password = settings.store_password
        return PostgresStore(
            where, password=None if password is None else password.get_secret_value(), limit_s=30.0
        )
    if not os.path.isfile(where):
        raise StoreError(f"{where}: no such file")
    return SqliteStore(Path(where), read_only=True)


def _all(store: Store) -> Iterator[ObservationPage]:
    cursor = 0
    while (found := store.observations_after(cursor, _AT_ONCE)).headings:
        yield found
        cursor = found.cursor


def _contributions(found: ObservationPage) -> Iterator[tuple[object, ...]]:
    """A heading, and how many of its observations are not forgotten."""
    counts = [0] * len(found.headings)
    for heading in found.heading_of.tolist():
        counts[heading] += 1
    return ((*heading, count) for heading, count in zip(found.headings, counts, strict=True))


def _records(found: ObservationPage) -> Iterator[tuple[object, ...]]:
    words = {"fix_quality": QUALITIES, "verdict": VERDICTS}
    names = OBSERVATION.names or ()
    for heading, row in zip(found.heading_of.tolist(), found.rows.tolist(), strict=True):
        values = (
            words[name][value] if name in words else value for name, value in zip(names, row, strict=True)
        )
        yield (*found.headings[heading], *values)


if __name__ == "__main__":
    raise SystemExit(main())
