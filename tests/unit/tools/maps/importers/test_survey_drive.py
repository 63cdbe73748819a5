"""Roads from confirmed positions: what half of a drive says of the other half, and what is left out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.mcap_recorder import Recorder
from camber.formats.drive.truth_csv import TruthTable, write_truth
from camber.formats.map_exchange.argoverse import read_log
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import read_release
from camber.road_map.road_columns import RoadSurfaces
from camber.schemas.antenna import AntennaHeight
from camber.schemas.codec import encode
from camber.schemas.integrity import Verdict
from camber.tools.maps.importers.argoverse import CityFrame
from camber.tools.maps.importers.surfaces_along import Floats, surfaces_along
from camber.tools.maps.importers.survey_drive import RoadTrack, drive_roads
from camber.tools.maps.importers.track_heights import TrackHeights
from support.built_maps import build_map
from support.nearest_surface import nearest_heights
from support.refusals import Refused

FRAME = LocalFrame(math.radians(35.1), math.radians(137.0), 0.0)
START_NS = 1_400_000_000 * 10**9
ANTENNA_M = 1.8


def heights(surfaces: RoadSurfaces, latitude: Floats, longitude: Floats, level: int | None = None) -> Floats:
    """Of the nearest surface, NaN where none is within half a metre."""
    return nearest_heights(surfaces, latitude, longitude, near_m=0.5, level=level)[0]


@pytest.mark.parametrize("name", ["7fab2350", "3bffdcff"])
@pytest.mark.parametrize("block_m", [0.0, 3.0, 5.0])
def test_half_of_the_poses_predict_the_other_half(data: Path, name: str, block_m: float) -> None:
    """Every other pose, and every other stretch of three and five metres."""
    log = read_log(data / "av2" / name)
    places_m = log.city_from_egovehicle[:, :3, 3]
    latitude, longitude = CityFrame.of_city(log.city).to_geodetic(places_m[:, 0], places_m[:, 1])
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(places_m[:, :2], axis=0).T)))
    half = (along_m // block_m if block_m else np.arange(len(places_m))) % 2 == 0
    track = RoadTrack(
        latitude_rad=latitude[half],
        longitude_rad=longitude[half],
        road_height_m=places_m[half, 2],
        sigma_m=np.full(half.sum(), 0.02),
        last_ns=START_NS,
    )
    roads = drive_roads(track, name, 3.0, 4.0)
    surfaces = surfaces_along(roads.roads, roads.ground, spacing_m=2.0, seen_ns=START_NS, vehicles=1)
    off_m = heights(surfaces, latitude[~half], longitude[~half]) - places_m[~half, 2]
    known = np.isfinite(off_m)
    print(f"{name}, blocks of {block_m:g} m: p95 {np.percentile(np.abs(off_m[known]), 95):.4f} m, "
          f"known {known.mean():.3f}, σ {np.median(surfaces.sigma_m):.3f} m")  # fmt: skip
    assert known.mean() > 0.85
    assert np.percentile(np.abs(off_m[known]), 95) <= 0.03


def test_heights_are_compared_with_the_positions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], refused: Refused
) -> None:
    write_truth(tmp_path / "truth.csv", drive(over=True))
    options = ("--antenna-height-m", ANTENNA_M, "--check-seed", 17, tmp_path / "truth.csv")
    assert build_map("drive", tmp_path / "map", *options) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "against the source" in line)
    assert "(seed 17)" in line
    assert int(line.split(" places")[0].split()[-1]) > 1900
    fitted = TrackHeights.at

    def shifted(self: TrackHeights, places_m: Floats, about_m: Floats) -> tuple[Floats, Floats]:
        height_m, sigma_m = fitted(self, places_m, about_m)
        return height_m + 0.1, sigma_m

    monkeypatch.setattr(TrackHeights, "at", shifted)
    line = refused(lambda _: build_map("drive", tmp_path / "other", *options))
    assert "expected the source's within 3 σ (seed 17)" in line
    assert "height at position " in line


def drive(*, over: bool = False) -> TruthTable:
    """Positions of the antenna every metre along 200 m, over 6 m above it if asked, and nothing within 90 to 110 m."""
    x = np.concatenate((np.arange(0.0, 90.0), np.arange(110.0, 200.0)))
    plane = np.column_stack((x, 0.0 * x))
    height = 50.0 + 0.03 * x
    if over:
        back = np.arange(-60.0, 60.0)
        plane = np.vstack((plane, np.column_stack((np.full(len(back), 50.0), back))))
        height = np.concatenate((height, np.full(len(back), 50.0 + 1.5 + 6.0)))
    n = len(plane)
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(plane, 0.0)
    rng = np.random.default_rng(4)
    up = height + ANTENNA_M + rng.normal(0.0, 0.005, n)
    time_ns = START_NS + np.arange(n) * 10**8
    level = {"roll_rad": np.zeros(n), "pitch_rad": np.zeros(n), "yaw_rad": np.zeros(n)}
    place = {"latitude_rad": latitude, "longitude_rad": longitude, "height_m": up}
    return TruthTable(time_ns=time_ns, **place, **level, velocity_enu_m_s=np.zeros((n, 3)))


def build(path: Path, *more: str) -> int:
    return build_map("drive", path.parent / "map", *more, path)


def test_a_drive_over_its_earlier_road_makes_two_levels_and_none_without_positions(
    tmp_path: Path,
) -> None:
    write_truth(tmp_path / "truth.csv", drive(over=True))
    assert build(tmp_path / "truth.csv", "--antenna-height-m", f"{ANTENNA_M}") == 0
    release = read_release(tmp_path / "map")
    surfaces, links = release.road_surfaces(), release.road_links()
    assert set(surfaces.link_id.tolist()) <= set(links.link_id.tolist())
    assert (surfaces.vehicles == 1).all()
    assert 0.02 < surfaces.sigma_m.min() <= surfaces.sigma_m.max() < 0.08
    place = np.array([[20.0, 0.0], [50.0, 0.0], [100.0, 0.0], [150.0, 1.0]])
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(place, 0.0)
    by_level = {
        level: heights(surfaces, latitude, longitude, level) for level in np.unique(surfaces.level).tolist()
    }
    assert set(by_level) == {0, 1}
    assert by_level[0][[0, 1, 3]] == pytest.approx([50.6, 51.5, 54.5], abs=0.02)
    assert math.isnan(by_level[0][2])
    assert by_level[1][1] == pytest.approx(57.5, abs=0.02)


def recorded(path: Path, method: str, wrong_from: int) -> Path:
    """A replay whose judge confirmed all but the epochs from `wrong_from` on, which are 3 m too high."""
    truth = drive()
    with Recorder(path / "recording.mcap") as recorder:
        for k in range(len(truth)):
            time_ns = int(truth.time_ns[k])
            known = {"status": "known", "way": method, "height_m": ANTENNA_M, "sigma_m": 0.01}
            height = AntennaHeight(time_ns=time_ns, **known)
            wrong = k >= wrong_from
            verdict = Verdict(
                time_ns=time_ns,
                fix_id=k,
                verdict="erroneous" if wrong else "confirmed",
                reason="none",
                latitude_rad=float(truth.latitude_rad[k]),
                longitude_rad=float(truth.longitude_rad[k]),
                height_m=float(truth.height_m[k]) + (3.0 if wrong else 0.0),
                covariance_enu_m2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4),
            )
            for name, service, message in (
                ("antenna_height", "antenna_height/height", height),
                ("verdict", "integrity/verdict", verdict),
            ):
                payload = encode(message, source="t", sequence=k)
                recorder.add(name, payload, key=f"camber/v1/car/{service}", arrival_ns=time_ns)
        recorder.tick_done()
    return path


def test_of_a_replay_only_what_the_judge_confirmed_becomes_road(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    assert build(recorded(folder, "stroke", 60)) == 0
    surfaces = read_release(tmp_path / "map").road_surfaces()
    truth = drive()
    road_m = heights(surfaces, truth.latitude_rad, truth.longitude_rad)
    assert np.abs(road_m[:60] - (truth.height_m[:60] - ANTENNA_M)).max() < 0.03
    assert np.isnan(road_m[66:]).all()


def test_an_antenna_s_height_that_rests_on_the_map_makes_no_map(tmp_path: Path, refused: Refused) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    line = refused(lambda _: build(recorded(folder, "scan_matching", 60)))
    assert "does not rest on the map" in line
    assert build(folder, "--antenna-height-m", f"{ANTENNA_M}") == 0


def test_a_truth_without_an_antenna_s_height_or_that_stands_still_is_refused(
    tmp_path: Path, refused: Refused
) -> None:
    write_truth(tmp_path / "truth.csv", drive())
    assert "--antenna-height-m" in refused(lambda _: build(tmp_path / "truth.csv"))
    still = drive().rows(np.array([0]))
    write_truth(tmp_path / "truth.csv", still)
    assert build(tmp_path / "truth.csv", "--antenna-height-m", "1.8") == 2
    assert build(tmp_path / "none.csv", "--antenna-height-m", "1.8") == 2
