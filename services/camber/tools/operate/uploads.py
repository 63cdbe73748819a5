"""`camber uploads STORE`: export the contents of the fleet's store as CSV; read only.

STORE is the file uploads.sqlite or the address of a database as for `camber map_update --store`; the password is taken
from the environment.
"""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from camber.map_update.contribution import OBSERVATION, QUALITIES, VERDICTS
from camber.map_update.settings import MapUpdateSettings
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import ENTRY_COLUMNS, LedgerEntry, ObservationPage, Store, StoreError
from camber.runtime.settings import ConfigError, load
from camber.tools.options.parsers import tool_parser

_PROG = "camber uploads"
_PAGE_SIZE = 50_000  # chosen: some megabytes


def main(argv: list[str] | None = None) -> int:
    """Write the CSV; return 2 where the store cannot be read."""
    parser = tool_parser(_PROG, __doc__)
    parser.add_argument("store", metavar="STORE")
    parser.add_argument("--records", action="store_true", help="observations; without it: contributions")
    args = parser.parse_args(argv)
    try:
        with closing(_opened(args.store)) as store:
            out = csv.writer(sys.stdout, lineterminator="\n")
            out.writerow([*ENTRY_COLUMNS, *((OBSERVATION.names or ()) if args.records else ("records",))])
            cursor = 0
            while (page := store.observations_after(cursor, _PAGE_SIZE)).entries:
                out.writerows(_records(page) if args.records else _contributions(page))
                cursor = page.cursor
            sys.stdout.flush()
    except (StoreError, ConfigError) as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    return 0


def _opened(where: str) -> Store:
    if "://" in where:
        from camber.map_update.stores.postgres_store import PostgresStore

        settings, _ = load(MapUpdateSettings, [f"--store={where}"], prog=_PROG)
        secret = settings.store_password
        password = None if secret is None else secret.get_secret_value()
        return PostgresStore(where, password=password, limit_s=30.0)
    if not os.path.isfile(where):
        raise StoreError(f"{where}: no such file")
    return SqliteStore(Path(where), read_only=True)


def _contributions(page: ObservationPage) -> Iterator[tuple[object, ...]]:
    """Return the columns of each ledger entry, and the number of its observations that are not deleted."""
    counts = np.bincount(page.entry_of, minlength=len(page.entries)).tolist()
    return ((*_columns(entry), count) for entry, count in zip(page.entries, counts, strict=True))


def _records(page: ObservationPage) -> Iterator[tuple[object, ...]]:
    names_of = {"fix_quality": QUALITIES, "verdict": VERDICTS}
    for entry, row in zip(page.entry_of.tolist(), page.rows.tolist(), strict=True):
        values = zip(OBSERVATION.names or (), row, strict=True)
        texts = (names_of[name][value] if name in names_of else value for name, value in values)
        yield (*_columns(page.entries[entry]), *texts)


def _columns(entry: LedgerEntry) -> tuple[object, ...]:
    return tuple(getattr(entry, name) for name in ENTRY_COLUMNS)
