"""The map: questions to the map server, its answers, and what a release is made of.

A **release** is a folder, the same on disk, in the vehicle's store and in the cloud:

    root.msgpack            ReleaseRoot: version, SHA-256 of the manifest, Ed25519 signature
    blobs/<2 hex>/<sha256>  Manifest, SurfaceTile, LinkTile, CloudTile, each as `codec.encode` writes it

Blobs are named by the SHA-256 of their bytes, so equal tiles of two releases are one blob. Tiles are Web-Mercator
z/x/y at ZOOM; geometry is in east/north metres about the tile's centre (tangent plane at height zero, ellipsoidal
heights carried apart; yaws against east at the tile's centre). What comes within 1 m of a tile stands whole in it. The
`time_ns` of a tile is that of its newest evidence, never of the release, so that what did not change stays the same
blob. Surface and link ids are never reused; what became of a surface stands in the lineage.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from camber.schemas.base import (
    ArrayOf,
    Count,
    Float32,
    Float64,
    Height,
    Int32,
    Int64,
    Latitude,
    Longitude,
    Message,
    Model,
    Name,
    Sha256,
    Text,
    UInt8,
)
from camber.schemas.pose import Road

ZOOM = 16
"""Tiles of about 500 m at 35° latitude."""

Layer = Literal["surfaces", "links", "environment_cloud", "road_cloud"]
LAYERS: tuple[Layer, ...] = ("surfaces", "links", "environment_cloud", "road_cloud")
TileNumber = Annotated[int, Field(ge=0, lt=1 << ZOOM)]


MAX_PLACES = 1024  # chosen: keeps a reply below 256 kB


class Places(Model):
    """Places near a point, in its tangent plane at height zero."""

    east_m: Annotated[Float64, ArrayOf("<f8", ("places",), ge=-200.0, le=200.0)]
    north_m: Annotated[Float64, ArrayOf("<f8", ("places",), ge=-200.0, le=200.0)]

    @model_validator(mode="after")
    def _not_too_many(self) -> Self:
        if len(self.east_m) > MAX_PLACES:
            raise ValueError(f"{len(self.east_m)} places, expected at most {MAX_PLACES}")
        return self


class RoadsAhead(Model):
    """The roads at those of the places asked for where one is known, as columns; all of one map version and datum."""

    place: Annotated[Int32, ArrayOf("<i4", ("known",), ge=0, le=MAX_PLACES - 1)] = Field(
        description="number of the place in the request, ascending"
    )
    surface_id: Annotated[Int64, ArrayOf("<i8", ("known",), ge=0)]
    level: Annotated[Int32, ArrayOf("<i4", ("known",), ge=-20, le=20)]
    elevation_m: Annotated[Float64, ArrayOf("<f8", ("known",), ge=-20_000.0, le=100_000.0)]
    sigma_m: Annotated[Float64, ArrayOf("<f8", ("known",), ge=0.0)]
    slope_east: Annotated[Float64, ArrayOf("<f8", ("known",), ge=-2.0, le=2.0)]
    slope_north: Annotated[Float64, ArrayOf("<f8", ("known",), ge=-2.0, le=2.0)]
    extent_m: Annotated[Float64, ArrayOf("<f8", ("known",), ge=0.0)]


class ElevationRequest(Message):
    """Which road is under this point? Links and the last surface say on which level, never the height under test."""

    latitude_rad: Latitude
    longitude_rad: Longitude
    link_ids: tuple[Count, ...] = Field(
        (), max_length=16, description="links the vehicle may be on, by its own topology; empty: not known"
    )
    last_surface_id: Count | None = None
    radius_m: Annotated[float, Field(ge=0.0, le=100.0)] = Field(
        0.0, description="how far the point may be off: above 0 the reply has a patch of that radius"
    )
    ahead: Places | None = Field(
        None, description="where the vehicle will be next, about the point: saves it some questions"
    )


class ElevationReply(Message):
    """The road there, or why it is not known."""

    road: Road
    ahead: RoadsAhead | None = Field(None, description="where it was asked for and the road is known")


class LinksRequest(Message):
    """The links around a point."""

    latitude_rad: Latitude
    longitude_rad: Longitude
    radius_m: Annotated[float, Field(gt=0.0, le=2_000.0)]


class LinksReply(Message):
    """Links as columns; vertices of link i are rows `first_vertex[i]` to `first_vertex[i + 1]`."""

    status: Literal["known", "unknown"]
    reason: Text = ""
    map_version: Count
    link_id: Annotated[Int64, ArrayOf("<i8", ("links",))]
    start_node: Annotated[Int64, ArrayOf("<i8", ("links",))]
    end_node: Annotated[Int64, ArrayOf("<i8", ("links",))]
    level: Annotated[Int32, ArrayOf("<i4", ("links",))]
    sigma_m: Annotated[Float64, ArrayOf("<f8", ("links",), ge=0.0)]
    first_vertex: Annotated[Int32, ArrayOf("<i4", ("links+1",), offsets_into="vertices")]
    latitude_rad: Annotated[Float64, ArrayOf("<f8", ("vertices",))]
    longitude_rad: Annotated[Float64, ArrayOf("<f8", ("vertices",))]


class TileRequest(Message):
    """One layer of one tile."""

    x: TileNumber
    y: TileNumber
    layer: Layer
    have_sha256: Sha256 | None = None
    part: Count = 0


class TileReply(Message):
    """The tile's blob in parts of at most 256 kB, or why there is none."""

    status: Literal["known", "unchanged", "unknown"]
    reason: Text = ""
    sha256: Sha256 | None = None
    parts: Count = 0
    payload: Annotated[UInt8, ArrayOf("|u1", ("bytes",))]


class SurfaceTile(Message):
    """Road surfaces that touch a tile: oriented rectangles, each with a small grid of heights (2 × 2 is a plane).

    Grid of surface i: `rows[i]` along × `columns[i]` across (from −half to +half, across positive to the left),
    row-major from `first_height[i]`; `height_m = base_height_m + grid`, bilinear between the points.
    """

    x: TileNumber
    y: TileNumber
    base_height_m: Height
    surface_id: Annotated[Int64, ArrayOf("<i8", ("surfaces",))]
    link_id: Annotated[Int64, ArrayOf("<i8", ("surfaces",))]
    level: Annotated[Int32, ArrayOf("<i4", ("surfaces",))]
    centre_east_m: Annotated[Float64, ArrayOf("<f8", ("surfaces",))]
    centre_north_m: Annotated[Float64, ArrayOf("<f8", ("surfaces",))]
    yaw_rad: Annotated[Float64, ArrayOf("<f8", ("surfaces",))]
    half_length_m: Annotated[Float32, ArrayOf("<f4", ("surfaces",), ge=0.0)]
    half_width_m: Annotated[Float32, ArrayOf("<f4", ("surfaces",), ge=0.0)]
    rows: Annotated[Int32, ArrayOf("<i4", ("surfaces",), ge=2)]
    columns: Annotated[Int32, ArrayOf("<i4", ("surfaces",), ge=2)]
    first_height: Annotated[Int32, ArrayOf("<i4", ("surfaces",), ge=0)]
    sigma_m: Annotated[Float32, ArrayOf("<f4", ("surfaces",), ge=0.0)]
    vehicles: Annotated[Int32, ArrayOf("<i4", ("surfaces",), ge=0)]
    last_seen_ns: Annotated[Int64, ArrayOf("<i8", ("surfaces",))]
    grid_m: Annotated[Float32, ArrayOf("<f4", ("heights",))]

    @model_validator(mode="after")
    def _grids_lie_within_heights(self) -> Self:
        end = self.first_height.astype(np.int64) + self.rows.astype(np.int64) * self.columns
        if (end > len(self.grid_m)).any():
            raise ValueError(f"a grid ends beyond the {len(self.grid_m)} heights")
        return self


class LinkTile(Message):
    """Links that touch a tile, each whole; columns as in LinksReply, vertices in tile-local metres."""

    x: TileNumber
    y: TileNumber
    link_id: Annotated[Int64, ArrayOf("<i8", ("links",))]
    start_node: Annotated[Int64, ArrayOf("<i8", ("links",))]
    end_node: Annotated[Int64, ArrayOf("<i8", ("links",))]
    level: Annotated[Int32, ArrayOf("<i4", ("links",))]
    sigma_m: Annotated[Float32, ArrayOf("<f4", ("links",), ge=0.0)]
    first_vertex: Annotated[Int32, ArrayOf("<i4", ("links+1",), offsets_into="vertices")]
    east_m: Annotated[Float64, ArrayOf("<f8", ("vertices",))]
    north_m: Annotated[Float64, ArrayOf("<f8", ("vertices",))]


class CloudTile(Message):
    """Points of a tile, quantised: metres about the tile's centre and `base_height_m` are `quanta × resolution_m`."""

    x: TileNumber
    y: TileNumber
    layer: Layer
    base_height_m: Height
    resolution_m: Annotated[float, Field(gt=0.0, le=1.0)]
    quanta: Annotated[Int32, ArrayOf("<i4", ("points", 3))]


class Manifest(Message):
    """What a release holds; `time_ns` is when it was made. Row i: one layer of one tile."""

    region: Name
    map_version: Count
    datum: Name = Field(description="of positions and ellipsoidal heights, e.g. WGS84")
    epoch_year: Annotated[float, Field(ge=1980.0, le=2200.0)]
    surrogate: Text = Field("", description="not empty: not surveyed, and made how")
    previous_sha256: Sha256 | None = None
    reference_sha256: Sha256 | None = Field(
        None, description="manifest of the survey or import that this release corrects; None: it is one"
    )
    corrections_sha256: Sha256 | None = Field(
        None, description="SurfaceCorrections, kept where releases are made; None: it has none"
    )
    tile_x: Annotated[Int32, ArrayOf("<i4", ("blobs",))]
    tile_y: Annotated[Int32, ArrayOf("<i4", ("blobs",))]
    layer: Annotated[UInt8, ArrayOf("|u1", ("blobs",), le=3)] = Field(description="index into LAYERS")
    sha256: Annotated[UInt8, ArrayOf("|u1", ("blobs", 32))]
    size_bytes: Annotated[Int64, ArrayOf("<i8", ("blobs",), ge=0)]
    lineage_surface_id: Annotated[Int64, ArrayOf("<i8", ("lineage",))] = Field(
        description="a surface of this release"
    )
    lineage_parent_id: Annotated[Int64, ArrayOf("<i8", ("lineage",))] = Field(
        description="a surface of an earlier release that it was split or merged from"
    )


class SurfaceCorrections(Message):
    """By how much the surfaces of a release differ from those of its reference; `time_ns` as of the release.

    Row i is about one surface, in the order of ids: the whole surface lies `offset_m` higher than in the reference.
    """

    surface_id: Annotated[Int64, ArrayOf("<i8", ("surfaces",), ge=0)]
    offset_m: Annotated[Float64, ArrayOf("<f8", ("surfaces",), ge=-100.0, le=100.0)]
    sigma_m: Annotated[Float64, ArrayOf("<f8", ("surfaces",), ge=0.0, le=1000.0)] = Field(
        description="of the corrected height"
    )
    vehicles: Annotated[Int32, ArrayOf("<i4", ("surfaces",), ge=0)]
    last_seen_ns: Annotated[Int64, ArrayOf("<i8", ("surfaces",))]
    since_map_version: Annotated[Int64, ArrayOf("<i8", ("surfaces",), ge=0)] = Field(
        description="the release that first had this offset"
    )


class ReleaseRoot(Message):
    """The signed head of a release; the signature is over `signed_bytes` of the other fields."""

    region: Name
    map_version: Count
    manifest_sha256: Sha256
    key_id: Name | None = Field(None, description="which key signed; None: unsigned")
    signature: Annotated[UInt8, ArrayOf("|u1", (64,))] | None = Field(None, description="Ed25519")


def signed_bytes(root: ReleaseRoot) -> bytes:
    """What the signature of a release root covers."""
    text = f"camber release 1\n{root.region}\n{root.map_version}\n{root.manifest_sha256}\n{root.time_ns}\n"
    return text.encode()
