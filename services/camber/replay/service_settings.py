"""The settings that each service gets for a drive, from the drive's manifest."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from camber.replay.drive_inputs import DriveInputs
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import SERVICES
from camber.schemas.drive import DriveManifest, ManifestError
from camber.schemas.refused_field import first_refused
from camber.tools.localize.localizer_config import localizer_config

S = TypeVar("S", bound=ServiceSettings)

EPHEMERIDES_OF_SATELLITE = 150
"""A replay reads the navigation files of a whole day at its first tick: 24 h of ephemerides, at most one in 10 minutes
(BeiDou, Galileo; RINEX 3.04 navigation files)."""

ServiceTables = dict[str, Mapping[str, Any]]
"""Service → its settings as a table."""


def service_settings(inputs: DriveInputs, folder: Path) -> ServiceTables:
    """Return the settings of all services; they keep their state in `folder`/state."""
    manifest, raw = inputs.manifest, inputs.manifest.observations
    engine: dict[str, Any] = {"ephemerides_of_satellite": EPHEMERIDES_OF_SATELLITE}
    if raw is not None:
        engine["ambiguities"] = raw.ambiguities
    base = {} if raw is None or raw.base_ecef_m is None else {"base_ecef_m": list(raw.base_ecef_m)}
    of_drive: ServiceTables = {
        "gnss": {
            "source": "bus",
            "datum": manifest.datum,
            "positions": manifest.judged_positions,
            "engine": engine,
            **base,
        },
        "map_server": {
            "release": (inputs.map_release or folder / "work" / "no-map").resolve(),
            "datum": manifest.datum,
        },
        "localizer": {
            "match_sweeps": manifest.sweeps is not None,
            **localizer_config(manifest, inputs.initial_pose),
        },
        "antenna_height": antenna_height_settings(manifest),
        "integrity": {
            "alert_limit_m": manifest.alert_limit_m,
            "horizontal_reference": manifest.horizontal_reference,
        },
    }
    return {
        name: {
            "vehicle": manifest.vehicle,
            "clock": "replay",
            "state_dir": folder / "state" / name,
            **of_drive.get(name, {}),
        }
        for name in SERVICES
    }


def antenna_height_settings(manifest: DriveManifest) -> dict[str, Any]:
    """Return all by which the antenna's height can be determined on this drive, so that the methods are compared."""
    height, lever_arms = manifest.antenna_height, manifest.lever_arms.with_given_height
    if height is None:
        return {}
    equipped = {
        "antenna": True,
        "suspension": manifest.suspension is not None,
        "ranging": manifest.ranging is not None,
        "lidar": manifest.sweeps is not None,
    }
    settings = {
        "fixed_height_m": height.height_m,
        "fixed_sigma_m": height.sigma_m,
        "suspension_to_antenna_m": height.suspension_to_antenna_m,
        "tyre_radius_m": height.tyre_radius_m,
        **{
            name: lever_arms[name].model_dump()
            for name, has in equipped.items()
            if has and name in lever_arms
        },
    }
    return {
        "way": height.way,
        "beam_azimuth_deg": height.beam_azimuth_deg,
        **{name: value for name, value in settings.items() if value is not None},
    }


def validated_settings(service: str, kind: type[S], table: Mapping[str, Any]) -> S:
    """Return a service's settings, from the table alone: the user's environment must not change a replay.

    Raises ManifestError that names the service and the setting.
    """
    environment = {name: os.environ.pop(name) for name in list(os.environ) if name.startswith("CAMBER_")}
    try:
        return kind(**table)
    except ValidationError as error:
        field = first_refused(error, whole="settings")
        actual = "" if field.value is None else f" (got {field.value[:60]!r})"
        raise ManifestError(f"{service}: {field}{actual}") from None
    finally:
        os.environ.update(environment)
