"""A signing key is replaced with an overlap: each counts on its days, and no third one does."""

from __future__ import annotations

import os
from datetime import date
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import ValidationError

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_server.settings import MapServerSettings
from camber.road_map.release import ReleaseError, open_release
from support.release_world import KEY, OTHER_KEY, public_pem
from support.small_map import surface, write

THIRD_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(2, 34)))


def gps_ns(day: date) -> int:
    return (day - date(1980, 1, 6)).days * NS_PER_DAY + NS_PER_DAY // 2


def rotation(folder: Path) -> MapServerSettings:
    (folder / "old.pub").write_bytes(public_pem(KEY))
    (folder / "new.pub").write_bytes(public_pem(OTHER_KEY))
    return MapServerSettings(
        release=folder / "map",
        public_key=folder / "old.pub",
        public_key_last_day=date(2027, 6, 30),
        next_public_key=folder / "new.pub",
        next_public_key_first_day=date(2027, 6, 1),
    )


def is_accepted(settings: MapServerSettings, key: Ed25519PrivateKey, day: date) -> bool:
    assert settings.release is not None
    write(settings.release, [surface(1)], signing_key=key)
    trusted = settings.trusted_key(lambda: gps_ns(day))
    try:
        open_release(settings.release, public_key=trusted)
    except ReleaseError as error:
        return "key_id" not in str(error)
    return True


@pytest.mark.parametrize(
    ("day", "old", "new"),
    [
        (date(2027, 5, 31), True, False),
        (date(2027, 6, 1), True, True),
        (date(2027, 6, 30), True, True),
        (date(2027, 7, 1), False, True),
    ],
)
def test_each_key_counts_on_its_days_and_both_in_between(
    day: date, old: bool, new: bool, tmp_path: Path
) -> None:
    settings = rotation(tmp_path)
    assert is_accepted(settings, KEY, day) is old
    assert is_accepted(settings, OTHER_KEY, day) is new
    assert not is_accepted(settings, THIRD_KEY, day)


def test_a_release_that_names_a_key_but_was_signed_with_another_is_refused(tmp_path: Path) -> None:
    settings = rotation(tmp_path)
    write(tmp_path / "map", [surface(1)], signing_key=None)
    with pytest.raises(ReleaseError, match="signature"):
        open_release(tmp_path / "map", public_key=settings.trusted_key(lambda: gps_ns(date(2027, 6, 15))))


def test_keys_without_an_overlap_are_refused(tmp_path: Path) -> None:
    table = rotation(tmp_path).model_dump(exclude_unset=True)
    with pytest.raises(ValidationError, match=r"next_public_key_first_day: expected 2027-06-30 .* or before"):
        MapServerSettings(**table | {"next_public_key_first_day": date(2027, 7, 1)})
    with pytest.raises(ValidationError, match="next_public_key: expected public_key, too"):
        MapServerSettings(**table | {"public_key": None})


def test_a_pipe_in_the_place_of_a_key_is_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "key.pub")
    with pytest.raises(
        ValidationError, match=r"key\.pub: public key, expected an Ed25519 key in PEM .*not a plain file"
    ):
        MapServerSettings(release=tmp_path / "map", public_key=tmp_path / "key.pub")
