"""Parameters of the RTK engine: signals, masks and tests. They are the table `engine` of the service's settings."""

from __future__ import annotations

import math
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from camber.gnss.ambiguity.ambiguity_resolution import FixCriteria
from camber.gnss.observations.differenced_observations import Masks
from camber.gnss.observations.signal_pairs import Booleans, groups_of


class EngineSettings(BaseModel):
    """Parameters of the RTK engine."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    gps_bands: str = Field("125", description="bands of GPS and QZSS that are used, as RINEX digits")
    galileo_bands: str = Field("157", description="bands of Galileo; empty: not used")
    beidou_bands: str = Field("12567", description="bands of BeiDou; empty: not used")
    glonass_bands: str = Field("12", description="bands of GLONASS, whose codes are used; empty: not used")
    lowest_elevation_deg: float = Field(10.0, ge=0.0, le=60.0, description="elevation mask")
    least_cn0_dbhz: float = Field(30.0, ge=0.0, le=60.0, description="C/N0 mask")
    least_ratio: float = Field(3.0, ge=1.0, le=100.0, description="threshold of the ratio test")
    failure_rate: float = Field(
        0.0,
        ge=0.0,
        le=0.01,
        description="fixed failure rate: a ratio threshold that keeps it replaces least_ratio; 0: not used",
    )
    least_success_rate: float = Field(
        0.95, ge=0.0, lt=1.0, description="least bootstrapped success rate of the ambiguities that are fixed"
    )
    least_fixed: int = Field(4, ge=3, le=100, description="least number of fixed ambiguities")
    partial: bool = Field(True, description="partial ambiguity resolution where not all can be fixed")
    doppler_aided: bool = Field(
        True, description="prior of the float position: the last one, propagated by the Doppler velocity"
    )
    ambiguities: Literal["single_epoch", "carried"] = Field(
        "single_epoch",
        description="float ambiguities of each epoch alone, or carried along unbroken arcs from epoch to epoch",
    )
    ephemerides_of_satellite: int = Field(
        8, ge=2, le=1000, description="ephemerides kept per satellite; a whole day at once needs 150"
    )
    longest_base_age_s: float = Field(10.0, gt=0.0, le=60.0, description="maximum correction age")
    subset_agreement: bool = Field(
        True, description="compare each fix with those of its satellites less one system"
    )

    @model_validator(mode="after")
    def _known_bands(self) -> Self:
        self.groups()
        return self

    @field_validator("failure_rate")
    @classmethod
    def _within_the_table(cls, value: float) -> float:
        if 0.0 < value < 0.001:
            raise ValueError(f"{value}: expected 0 or from 0.001 to 0.01")
        return value

    def groups(self) -> Booleans:
        """The signal groups in use, as `groups_of`."""
        bands = {"G": self.gps_bands, "E": self.galileo_bands, "C": self.beidou_bands}
        return groups_of(bands | {"R": self.glonass_bands})

    def masks(self) -> Masks:
        """Elevation and C/N0 masks for the compiled code."""
        return Masks(math.radians(self.lowest_elevation_deg), self.least_cn0_dbhz)

    def fix_criteria(self) -> FixCriteria:
        """Acceptance tests of a fix for the compiled code."""
        return FixCriteria(
            least_ratio=self.least_ratio,
            least_success_rate=self.least_success_rate,
            least_fixed=self.least_fixed,
            partial=self.partial,
            failure_rate=self.failure_rate,
        )
