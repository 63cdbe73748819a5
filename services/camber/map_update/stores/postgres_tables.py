"""The tables of the store in PostgreSQL, and a view of the observations for queries by hand.

The observations of a contribution are one value of `packed`, as in SQLite: the array's bytes, little-endian, out of
line and not compressed. Writing costs the server a quarter of one table row for each observation
(`benchmarks/ingest.py`); queries of the view `observation` cost some microseconds a value instead.
"""

from __future__ import annotations

from camber.map_update.contribution import OBSERVATION
from camber.map_update.stores.store import LEDGER, TABLES


def _integer(at: int) -> str:
    return " | ".join(f"(get_byte(whole, start + {at + k})::bigint << {8 * k})" for k in range(8))


def _column(name: str) -> str:
    field, at = OBSERVATION.fields[name][:2] if OBSERVATION.fields else (OBSERVATION, 0)
    match field.kind:
        case "u":
            return f"get_byte(whole, start + {at})::smallint AS {name}"
        case "f":
            return f"float8_of_bits({_integer(at)}) AS {name}"
        case _:
            return f"{_integer(at)} AS {name}"


# IEEE 754: sign, exponent, fraction; all steps are exact. Numbers below 2⁻¹⁰²² are zero. RETURN is parsed at creation,
# so the view does not depend on the search path. OFFSET 0: out-of-line values are fetched once, not for every byte.
_VIEW = f"""
CREATE FUNCTION float8_of_bits(bits bigint) RETURNS double precision LANGUAGE sql IMMUTABLE STRICT
RETURN CASE WHEN ((bits >> 52) & 2047) = 0 THEN 0.0
    ELSE sign(bits::double precision) * (1 + (bits & 4503599627370495) / 4503599627370496.0::double precision)
        * power(2.0::double precision, ((bits >> 52) & 2047) - 1023) END;
CREATE VIEW observation AS
SELECT contribution, {", ".join(map(_column, OBSERVATION.names or ()))}
FROM packed, LATERAL (SELECT packed.rows || ''::bytea AS whole OFFSET 0) AS fetched,
    generate_series(0, length(whole) - 1, {OBSERVATION.itemsize}) AS start;
"""

_TABLES = f"""
{LEDGER};
CREATE TABLE ledger_end (number bigint NOT NULL, partitions bigint NOT NULL);
INSERT INTO ledger_end VALUES (0, 0);
CREATE TABLE packed (contribution bigint NOT NULL, rows bytea NOT NULL) PARTITION BY RANGE (contribution);
ALTER TABLE packed ALTER rows SET STORAGE EXTERNAL;
{";".join(TABLES)};"""

CREATE = _TABLES.format(bigint="bigint", blob="bytea") + _VIEW
