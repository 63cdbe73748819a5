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


def test_an_unchanged_root_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, [surface(1)])
    watch = ReleaseWatch(tmp_path)
    settle(watch)
    monkeypatch.setattr("camber.road_map.release_watch.open_release", None)
    settle(watch)
    assert version(watch) == 7
