"""What a replay leaves behind, and what evaluation needs of it: the only place that knows the files of a run.

    recording.mcap  everything that was on the bus (`formats/recording.py`)
    drive.json      DriveFacts: what of the drive's manifest the figures rest on
    truth.npz       the reference track, where there is one: time_ns, latitude_rad, longitude_rad, height_m
    run.json        RunFacts: how fast it ran; absent where the run was not a replay
    summary.json    made by evaluation
    report.html     made by evaluation

Files appear whole or not at all. What cannot be read is a FormatError, one clear line.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import Field, ValidationError

from camber.formats.errors import FormatError
from camber.replay.drive_inputs import DriveInputs
from camber.road_map.release import ReleaseError, open_release
from camber.schemas.base import Model, Sigma
from camber.schemas.refused_field import first_refused
from camber.validation.reference_trajectory import ReferenceTrajectory, offset_of

# All that np.load has raised on files that are no archive of arrays, or a damaged one.
_NO_ARRAYS = (
    ValueError,
    TypeError,
    AttributeError,
    EOFError,
    OverflowError,
    RuntimeError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
_ARRAYS = ("time_ns", "latitude_rad", "longitude_rad", "height_m")
F = TypeVar("F", bound=Model)


class DriveFacts(Model):
    """What the figures rest on besides the recording."""

    drive: Annotated[str, Field(min_length=1, max_length=200, description="name of the drive")]
    surrogates: tuple[Annotated[str, Field(max_length=500)], ...] = Field(
        default=(), description="what was not measured but made up, and how; one line each"
    )
    truth: bool = Field(description="whether there is a truth.npz")
    offset_enu_m: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="constant datum offset receiver − reference: east, north, up"
    )
    alert_limit_m: Annotated[float, Field(gt=0.0, le=1e4)] | None = Field(
        default=None, description="horizontal; None: the positions' own"
    )
    fixed_tolerance_m: Annotated[float, Field(gt=0.0, le=1e3)] = Field(
        default=0.3, description="of the control that knows the height only"
    )
    map_release: Annotated[str, Field(max_length=4096)] | None = Field(
        default=None, description="folder of the map; within the run's folder it is relative to it"
    )


def drive_facts(inputs: DriveInputs, folder: Path | None = None) -> DriveFacts:
    """Return the facts of a drive that is about to be replayed, with where its map is if it is into a `folder`."""
    manifest = inputs.manifest
    release = None if inputs.map_release is None or folder is None else inputs.map_release.resolve()
    if release is not None and folder is not None and release.is_relative_to(folder.resolve()):
        release = release.relative_to(folder.resolve())
    return DriveFacts(
        drive=manifest.name,
        surrogates=(*manifest.surrogate_notes(), *_notes_of_map(inputs)),
        truth=inputs.truth is not None,
        offset_enu_m=offset_of(manifest),
        alert_limit_m=manifest.alert_limit_m,
        map_release=None if release is None else str(release),
    )


def _notes_of_map(inputs: DriveInputs) -> list[str]:
    """Return what a map that the manifest names says of itself, if it is no survey."""
    if inputs.manifest.map is None or inputs.map_release is None:
        return []
    with suppress(ReleaseError):  # the map server reports a map that cannot be read
        surrogate = open_release(inputs.map_release).manifest.surrogate
        return [f"map: {surrogate}"] if surrogate else []
    return []


class RunFacts(Model):
    """How the run went; what is not known is None."""

    speed_factor: Sigma | None = Field(default=None, description="time of the drive / time of the machine")
    wall_s: Sigma | None = None
    notes: tuple[Annotated[str, Field(max_length=500)], ...] = Field(
        default=(), description="what a reader should know, e.g. that the recording stopped on a full disk"
    )


class RunFolder:
    """The folder of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recording_path = path / "recording.mcap"
        self.drive_path = path / "drive.json"
        self.truth_path = path / "truth.npz"
        self.run_path = path / "run.json"
        self.summary_path = path / "summary.json"
        self.report_path = path / "report.html"

    def write_drive(self, facts: DriveFacts, truth: ReferenceTrajectory | None) -> None:
        """Write drive.json and, where there is truth, truth.npz. ValueError where `facts.truth` says
        otherwise."""
        if facts.truth != (truth is not None):
            raise ValueError(f"drive {facts.drive}: truth is {facts.truth}, but the arrays say otherwise")
        self.path.mkdir(parents=True, exist_ok=True)
        if truth is not None:
            archive = io.BytesIO()
            np.savez_compressed(archive, **{name: getattr(truth, name) for name in _ARRAYS})
            write_whole(self.truth_path, archive.getvalue())
        _write_text(self.drive_path, facts.model_dump_json(indent=2) + "\n")

    def write_run(self, facts: RunFacts) -> None:
        """Write run.json."""
        _write_text(self.run_path, facts.model_dump_json(indent=2) + "\n")

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write summary.json; what is not known is null."""
        _write_text(
            self.summary_path, json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        )

    def write_report(self, page: str) -> None:
        """Write report.html."""
        _write_text(self.report_path, page)

    def read_drive(self) -> DriveFacts:
        """Read drive.json."""
        return _read_json(self.drive_path, DriveFacts)

    def map_release(self, facts: DriveFacts) -> Path | None:
        """Folder of the drive's map; None where it had none."""
        return None if facts.map_release is None else self.path / facts.map_release

    def read_run(self) -> RunFacts:
        """Read run.json; nothing is known where there is none."""
        return _read_json(self.run_path, RunFacts) if self.run_path.exists() else RunFacts()

    def read_truth(self) -> ReferenceTrajectory:
        """Read truth.npz."""
        name = self.truth_path.name
        try:
            # Opened here: np.load leaves the file open where it is no archive.
            with self.truth_path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return ReferenceTrajectory(**{array: arrays[array] for array in _ARRAYS})
        except OSError as error:
            expected = "a readable file, as drive.json says that there is truth"
            raise FormatError(name, "file", expected, actual=error.strerror or str(error)) from None
        except KeyError:
            raise FormatError(name, "arrays", ", ".join(_ARRAYS)) from None
        except _NO_ARRAYS as error:
            raise FormatError(name, "arrays", f"a reference track: {str(error)[:120]}") from None


def write_whole(path: Path, data: bytes) -> None:
    """Write a file that appears whole or not at all."""
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(data)
    temporary.replace(path)


def _write_text(path: Path, text: str) -> None:
    write_whole(path, text.encode("utf-8"))


def _read_json(path: Path, cls: type[F]) -> F:
    try:
        return cls.model_validate_json(path.read_bytes())
    except OSError as error:
        raise FormatError(path.name, "file", "a readable file", actual=error.strerror or str(error)) from None
    except ValidationError as error:
        field = first_refused(error, whole="file")
        raise FormatError(path.name, field.name, field.expected) from None
