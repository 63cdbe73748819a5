"""Releases of a reference and corrections: only what was corrected changes, versions grow, ids are never used twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.map_update.fusion.correction_rows import (
    CORRECTION,
    NONE,
    Corrections,
    from_bytes,
    normalize,
    to_bytes,
)
from camber.map_update.release.release_builder import ReleaseBuilder, corrections_of, history
from camber.road_map.release import ReleaseError, open_release, read_release
from support.release_world import KEY, LINK
from support.small_map import DAY_NS, MADE_NS, surface, write


def corrections(*rows: tuple[Any, ...]) -> Corrections:
    """Rows of surface, offset; the rest as of five vehicles the day before yesterday."""
    full = [(row[0], row[1], *(row[2:] or (0.012, 5, MADE_NS + DAY_NS // 3)), 0) for row in rows]
    return np.array(full, CORRECTION)


def make_builder(folder: Path, rows: list[dict[str, Any]] | None = None, **changed: Any) -> ReleaseBuilder:
    """Releases in `folder/out` from a reference in `folder/in` with surfaces in several tiles."""
    grid_m = 50.0 + np.arange(6).reshape(3, 2) / 100
    rows = rows or [surface(i, 300.0 * i, heights_m=grid_m) for i in range(6)]
    write(folder / "in", rows, [LINK], **changed)
    return ReleaseBuilder(folder / "out", open_release(folder / "in"), signing_key=KEY)


def files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_release_has_the_corrections_and_is_the_reference_elsewhere(tmp_path: Path) -> None:
    builder = make_builder(tmp_path)
    root = builder.build(corrections((4, -0.05), (2, 0.0812)), time_ns=MADE_NS + DAY_NS)
    made = read_release(tmp_path / "out", public_key=KEY.public_key())
    assert (root.map_version, made.manifest.previous_sha256) == (8, builder.reference.root.manifest_sha256)
    new, old = made.road_surfaces(), builder.reference.road_surfaces()
    raised = [np.round(a - b, 6) for a, b in zip(new.heights_m, old.heights_m, strict=True)]
    assert [grid.min() for grid in raised] == pytest.approx([0, 0, 0.0812, 0, -0.05, 0], abs=1e-9)
    assert [np.ptp(grid) for grid in raised] == pytest.approx([0] * 6, abs=1e-9)
    assert new.vehicles.tolist() == [3, 3, 5, 3, 5, 3]
    assert new.sigma_m == pytest.approx([0.03, 0.03, 0.012, 0.03, 0.012, 0.03])
    assert new.latitude_rad.tobytes() == old.latitude_rad.tobytes()


def test_versions_of_another_reference_do_not_count(tmp_path: Path) -> None:
    builder = make_builder(tmp_path)
    first = builder.build(NONE, time_ns=MADE_NS)
    assert builder.versions_of_reference() == {builder.reference.root.map_version, first.map_version}
    rows = [surface(i, 300.0 * i) for i in range(7)]
    newer = make_builder(tmp_path, rows, map_version=first.map_version + 1)
    second = newer.build(NONE, time_ns=MADE_NS)
    assert newer.versions_of_reference() == {newer.reference.root.map_version, second.map_version}


def test_only_tiles_with_a_corrected_surface_change(tmp_path: Path) -> None:
    builder = make_builder(tmp_path)
    builder.build(NONE, time_ns=MADE_NS)
    before = open_release(tmp_path / "out")
    builder.build(corrections((2, 0.08)), time_ns=MADE_NS + 1)
    after = open_release(tmp_path / "out")
    changed = [after.tiles_by_hash()[digest][:3] for digest in after.hashes() - before.hashes()]
    tiles = after.tiles("surfaces")
    holding = [xy for xy in tiles if 2 in after.surface_tile(*xy).surface_id]  # type: ignore
    assert sorted(changed) == [("surfaces", *xy) for xy in holding]
    assert len(changed) < len(tiles)


def test_the_same_corrections_give_the_same_bytes_and_no_second_release(tmp_path: Path) -> None:
    for name in ("a", "b"):
        builder = make_builder(tmp_path / name)
        first = builder.build(corrections((2, 0.08), (3, 0.01)), time_ns=MADE_NS)
        again = builder.build(corrections((3, 0.01), (2, 0.08)), time_ns=MADE_NS + DAY_NS)
        assert again == first
    assert files(tmp_path / "a") == files(tmp_path / "b")


def test_a_built_release_has_the_same_bytes_as_ever(tmp_path: Path) -> None:
    root = make_builder(tmp_path).build(corrections((4, -0.05), (2, 0.0812)), time_ns=MADE_NS + DAY_NS)
    assert root.manifest_sha256 == "e2c613ea68846308e712273ee968fbec6474ba560a1237373fc7ab5cb89ffab8"


def test_a_roll_back_is_a_new_release_with_the_earlier_corrections(tmp_path: Path) -> None:
    builder = make_builder(tmp_path)
    versions = [builder.build(corrections((2, 0.01 * k)), time_ns=MADE_NS + k).map_version for k in (1, 2, 3)]
    then = read_release(tmp_path / "out").road_surfaces()
    assert versions == [8, 9, 10]
    root = builder.roll_back(8, time_ns=MADE_NS + 4)
    assert root.map_version == 11
    back = read_release(tmp_path / "out", public_key=KEY.public_key())
    assert builder.corrections()["offset_m"] == pytest.approx([0.01])
    assert builder.corrections()["since_map_version"].tolist() == [11]
    assert back.road_surfaces().heights_m[2][0, 0] == pytest.approx(then.heights_m[2][0, 0] - 0.02, abs=1e-9)
    assert [record.manifest.map_version for record in history(tmp_path / "out")] == [11, 10, 9, 8, 7]
    assert builder.roll_back(7, time_ns=MADE_NS + 5).map_version == 12
    assert len(builder.corrections()) == 0
    with pytest.raises(ReleaseError, match="version"):
        builder.roll_back(99, time_ns=MADE_NS + 6)


def test_an_unchanged_offset_keeps_its_first_release(tmp_path: Path) -> None:
    builder = make_builder(tmp_path)
    builder.build(corrections((2, 0.08)), time_ns=MADE_NS)
    builder.build(corrections((2, 0.08, 0.005, 9, MADE_NS), (3, 0.02)), time_ns=MADE_NS + 1)
    assert builder.corrections()["since_map_version"].tolist() == [8, 9]
    assert builder.corrections()["vehicles"].tolist() == [9, 5]


@pytest.mark.parametrize(
    ("rows", "field"),
    [
        (corrections((2, 0.1), (2, 0.2)), "each surface once"),
        (corrections((77, 0.1)), "a surface of the reference"),
        (corrections((2, float("nan"))), "finite"),
        (corrections((2, 99_000.0)), "at most 100 m"),
    ],
)
def test_invalid_corrections_are_refused_and_the_previous_release_stays(
    tmp_path: Path, rows: Corrections, field: str
) -> None:
    builder = make_builder(tmp_path)
    root = builder.build(NONE, time_ns=MADE_NS)
    with pytest.raises(ReleaseError, match=field):
        builder.build(rows, time_ns=MADE_NS + 1)
    assert read_release(tmp_path / "out").root == root


def test_lineage_is_kept_and_a_removed_id_is_never_reused(tmp_path: Path) -> None:
    builder = make_builder(tmp_path, [surface(1), surface(2, 50.0)])
    builder.build(corrections((1, 0.02)), time_ns=MADE_NS)

    def surveyed(name: str, rows: list[dict[str, Any]], version: int, **changed: Any) -> ReleaseBuilder:
        write(tmp_path / name, rows, map_version=version, **changed)
        return ReleaseBuilder(tmp_path / "out", open_release(tmp_path / name), signing_key=KEY)

    split = surveyed("split", [surface(2, 50.0), surface(3), surface(4, 10.0)], 20, lineage=[(3, 1), (4, 1)])
    assert split.build(NONE, time_ns=MADE_NS + 1).map_version == 21
    later = surveyed("later", [surface(2, 50.0), surface(3), surface(5, 10.0)], 5, lineage=[(5, 4)])
    assert later.build(NONE, time_ns=MADE_NS + 2).map_version == 22
    manifest = open_release(tmp_path / "out").manifest
    pairs = zip(manifest.lineage_surface_id.tolist(), manifest.lineage_parent_id.tolist(), strict=True)
    assert list(pairs) == [(3, 1), (5, 4)]
    for reused in (1, 4):
        with pytest.raises(ReleaseError, match="no id of a removed surface"):
            surveyed(f"again{reused}", [surface(2, 50.0), surface(reused, 90.0)], 30).build(
                NONE, time_ns=MADE_NS + 3
            )


def test_corrections_survive_a_round_trip(tmp_path: Path) -> None:
    rows = normalize(corrections((2, 0.08123), (1, -0.01)), NONE, 4)
    back = from_bytes(to_bytes(rows, MADE_NS))
    assert back.tobytes() == rows.tobytes()
    assert back["offset_m"] == pytest.approx([-0.01, 0.0812])
    assert (back["last_seen_ns"] % DAY_NS == 0).all()
    for damaged in (b"", to_bytes(rows, MADE_NS)[:-1]):
        with pytest.raises(ReleaseError):
            from_bytes(damaged)
    reference = make_builder(tmp_path).reference
    assert corrections_of(reference.source, reference.manifest).size == 0
