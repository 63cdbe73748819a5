"""A new release is used once all of it is verified; until then the old one stays (more in test_map_server_service)."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber.road_map.release_watch import ReleaseWatch
from support.small_map import surface, write


def settle(watch: ReleaseWatch) -> None:
    watch.look()
    while watch.busy:
        watch.verify(1)


def version(watch: ReleaseWatch) -> int | None:
    return None if watch.current is None else watch.current.manifest.map_version


def blobs(folder: Path) -> dict[Path, bytes]:
    return {p: p.read_bytes() for p in (folder / "blobs").rglob("*") if p.is_file()}


def test_a_release_is_current_only_when_all_of_it_is_verified(tmp_path: Path) -> None:
    write(tmp_path, [surface(i, 600.0 * i) for i in range(4)])
    watch = ReleaseWatch(tmp_path)
    watch.look()
    rounds = 0
    while watch.busy:
        assert watch.current is None
        watch.verify(1)
        rounds += 1
    assert rounds >= 4
    assert version(watch) == 7
    assert watch.problem is None


def test_an_invalid_release_leaves_the_old_one_in_use(tmp_path: Path) -> None:
    write(tmp_path, [surface(1)])
    watch = ReleaseWatch(tmp_path)
    settle(watch)
    before = blobs(tmp_path)
    write(tmp_path, [surface(1, heights_m=51.0)], map_version=8)
    good = {path: data for path, data in blobs(tmp_path).items() if path not in before}
    for path in good:
        path.write_bytes(b"half")
    settle(watch)
    assert version(watch) == 7
    assert watch.problem is not None
    # The rest of it came: it is noticed when the root is looked at anew.
    for path, data in good.items():
        path.write_bytes(data)
    settle(watch)
    assert version(watch) == 7
    watch.forget()
    settle(watch)
    assert version(watch) == 8
    assert watch.problem is None


def test_an_unchanged_root_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, [surface(1)])
    watch = ReleaseWatch(tmp_path)
    settle(watch)
    monkeypatch.setattr("camber.road_map.release_watch.open_release", None)
    settle(watch)
    assert version(watch) == 7
