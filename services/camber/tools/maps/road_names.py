"""Names of roads by the ids of links, from the file of lines that a map was made along.

A release has no names. The lines of GeoJSON and of OpenStreetMap give links their ids (`camber map build geotiff
--roads`, `camber map build geojson`), so the same file names them; in another one, ids and names do not match.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from camber.formats.errors import FormatError
from camber.formats.map_exchange.openstreetmap import SUFFIXES, read_roads
from camber.tools.maps.geojson import read_geojson
from camber.tools.maps.importers.lanes import named_links
from camber.tools.maps.importers.osm_tags import HIGHWAYS

_MOST_CHARACTERS = 80
"""Of a name. Chosen: a longer one is no name of a road, and would fill a table."""


def road_names(path: Path) -> dict[int, str]:
    """Return the names of the roads that have one, by link. Raises FormatError, or OSError if it cannot be read.

    A name is the tag `name`, else `ref`, the number of a road.
    """
    if path.name.endswith(SUFFIXES):
        roads = read_roads(path, frozenset(HIGHWAYS))
        links = named_links("link", [road.vertices_rad for road in roads])
        tags = [road.tags for road in roads]
    elif path.suffix in (".geojson", ".json"):
        _, links, properties = read_geojson(path)
        tags = [each.tags for each in properties]
    else:
        raise FormatError(
            str(path), "roads", f"a .geojson, or a file of OpenStreetMap ({', '.join(SUFFIXES)})"
        )
    named = zip(links.link_id.tolist(), map(_name_of, tags), strict=True)
    return {link_id: name for link_id, name in named if name}


def _name_of(tags: Mapping[str, str]) -> str:
    """One line without control characters."""
    text = tags.get("name") or tags.get("ref") or ""
    return "".join(c for c in " ".join(text.split()) if c.isprintable())[:_MOST_CHARACTERS]


def road_text(link_id: int | None, names: Mapping[int, str]) -> str:
    """What a road is called: its name, else the number of its link."""
    return "" if link_id is None else names.get(link_id, f"link {link_id}")
