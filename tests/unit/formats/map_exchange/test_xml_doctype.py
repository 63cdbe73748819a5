"""No importer reads XML with a DOCTYPE, whatever its encoding, and entities never grow."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from typing import Any

import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lanelet2 import lanelet_map
from camber.formats.map_exchange.opendrive import opendrive_map
from camber.formats.map_exchange.xml_doctype import refuse_doctype

ENTITIES = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 10}">' for k in range(9))
BOMB = f'<!DOCTYPE osm [<!ENTITY e0 "aaaaaaaaaa">{ENTITIES}]><osm>&e9;</osm>'
ENCODED = {
    "utf-8": BOMB.encode(),
    "utf-8 with a mark": codecs.BOM_UTF8 + BOMB.encode(),
    "declared utf-8": ('<?xml version="1.0" encoding="UTF-8"?>\n' + BOMB).encode(),
    "latin-1": ('<?xml version="1.0" encoding="ISO-8859-1"?>' + BOMB).encode("latin-1"),
    "windows-1252": ('<?xml version="1.0" encoding="windows-1252"?>' + BOMB).encode("cp1252"),
    "utf-16 with a mark": BOMB.encode("utf-16"),
    "utf-16-le with a mark": codecs.BOM_UTF16_LE + BOMB.encode("utf-16-le"),
    "utf-16-be with a mark": codecs.BOM_UTF16_BE + BOMB.encode("utf-16-be"),
    "utf-16-le": ('<?xml version="1.0" encoding="UTF-16LE"?>' + BOMB).encode("utf-16-le"),
    "utf-16-be": ('<?xml version="1.0" encoding="UTF-16BE"?>' + BOMB).encode("utf-16-be"),
    "behind a long comment": ("<!--" + "-a" * 5000 + "-->" + BOMB).encode("utf-16"),
    "external": b'<!DOCTYPE osm SYSTEM "file:///etc/passwd"><osm/>',
    "bare": b"<!DOCTYPE osm><osm/>",
}
UTF_32 = {"utf-32": BOMB.encode("utf-32"), "utf-32-be": codecs.BOM_UTF32_BE + BOMB.encode("utf-32-be")}
READERS: dict[str, Callable[[bytes, str], Any]] = {"lanelet2": lanelet_map, "opendrive": opendrive_map}


@pytest.mark.parametrize("data", ENCODED.values(), ids=ENCODED.keys())
@pytest.mark.parametrize("reader", READERS.values(), ids=READERS.keys())
def test_a_doctype_is_refused_in_every_encoding(reader: Callable[[bytes, str], Any], data: bytes) -> None:
    with pytest.raises(FormatError, match=r"^map\.xml: XML, expected a document without a DOCTYPE$"):
        reader(data, "map.xml")


@pytest.mark.parametrize("data", UTF_32.values(), ids=UTF_32.keys())
@pytest.mark.parametrize("reader", READERS.values(), ids=READERS.keys())
def test_utf_32_which_the_parser_does_not_know_is_refused(
    reader: Callable[[bytes, str], Any], data: bytes
) -> None:
    with pytest.raises(FormatError, match=r"^map\.xml: XML, expected a "):
        reader(data, "map.xml")


@pytest.mark.parametrize(
    "text",
    ["<osm/>", "<!-- <!DOCTYPE osm> --><osm/>", "<osm><![CDATA[<!DOCTYPE osm>]]></osm>", "", "<", "no xml"],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_what_has_no_doctype_is_left_to_the_reader(text: str, encoding: str) -> None:
    refuse_doctype(text.encode(encoding), "map.xml")
