"""Settings of the fleet's store."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from pydantic import Field

from camber.map_update.admission import Rules
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name


class MapUpdateSettings(ServiceSettings):
    """Settings of map_update: where uploads are stored, and which are impossible."""

    SERVICE: ClassVar[str] = "map_update"

    state_dir: Path = Field(Path("state/map_update"), description="folder of uploads.sqlite; on a local disk")
    busy_s: float = Field(
        0.5, ge=0.0, le=5.0, description="longest wait of a commit for another user of the file"
    )
    datums: list[Name] = Field(
        default_factory=lambda: ["WGS84", "ITRF2014", "ITRF2020", "JGD2011"],
        min_length=1,
        description="datums of positions and ellipsoidal heights that the fusion can bring together",
    )
    future_limit_s: float = Field(
        3600.0, ge=0.0, description="how far a positioning time may lie ahead of this machine's clock"
    )
    lowest_road_m: float = Field(-600.0, description="lowest ellipsoidal height of a road")
    highest_road_m: float = Field(7000.0, description="highest ellipsoidal height of a road")
    least_sigma_m: float = Field(
        0.001, gt=0.0, description="smallest standard deviation of a road height believed"
    )
    largest_sigma_m: float = Field(
        10.0, gt=0.0, description="largest standard deviation of a road height of any use"
    )
    highest_antenna_m: float = Field(20.0, gt=0.0, description="highest antenna above the road")
    most_records: int = Field(20_000, ge=1, description="most records in one batch")

    def rules(self) -> Rules:
        """The bounds as the admission wants them."""
        return Rules(
            datums=frozenset(self.datums),
            future_limit_s=self.future_limit_s,
            lowest_road_m=self.lowest_road_m,
            highest_road_m=self.highest_road_m,
            least_sigma_m=self.least_sigma_m,
            largest_sigma_m=self.largest_sigma_m,
            highest_antenna_m=self.highest_antenna_m,
            most_records=self.most_records,
        )
