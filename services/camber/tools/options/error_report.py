"""Failures of a command as one line and an exit code."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from camber.formats.errors import FormatError
from camber.replay.lock_step.feeder import ReplayStuckError
from camber.runtime.session import BusError
from camber.runtime.settings import ConfigError
from camber.schemas.toml_file import FileError


def report_failures(prog: str, out: Path, work: Callable[[], int]) -> int:
    """Run `work` and return its exit code; print a failure as one line: 1 bus, 2 file or setting, 130 interrupted."""
    try:
        return work()
    except (FileError, FormatError, ConfigError) as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{prog}: {error.filename or out}: {error.strerror or error}", file=sys.stderr)
        return 2
    except (ReplayStuckError, BusError) as error:
        print(f"{prog}: {error}; see {out / 'logs'}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{prog}: interrupted", file=sys.stderr)
        return 130
