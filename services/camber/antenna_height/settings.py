"""Settings of antenna_height."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from camber.runtime.settings import ServiceSettings


class AntennaHeightSettings(ServiceSettings):
    """How the antenna's height above the road is known."""

    SERVICE: ClassVar[str] = "antenna_height"

    way: Literal["fixed", "stroke"] = Field("fixed", description="the way whose height is passed on")
    fixed_height_m: float | None = Field(
        None,
        ge=-1.0,
        le=100.0,
        description="measured height of the antenna above the road; None: not measured",
    )
    fixed_sigma_m: float = Field(0.01, ge=0.0, le=1.0, description="σ of that")
    suspension_to_antenna_m: float | None = Field(
        None, ge=-10.0, le=10.0, description="h_ba of H (1), for way stroke; None: not measured"
    )
    tyre_radius_m: float | None = Field(
        None, gt=0.0, le=5.0, description="h_t of H (1), for way stroke; None: not measured"
    )
    stored_sigma_m: float = Field(0.01, ge=0.0, le=1.0, description="σ of h_ba and h_t together")
    publish_period_s: float = Field(0.2, gt=0.0, le=1.0, description="a fixed height is repeated this often")

    @model_validator(mode="after")
    def _stroke_is_measured(self) -> Self:
        if self.way == "stroke" and (self.suspension_to_antenna_m is None or self.tyre_radius_m is None):
            raise ValueError("way stroke needs suspension_to_antenna_m and tyre_radius_m")
        return self
