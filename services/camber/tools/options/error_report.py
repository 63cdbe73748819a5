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


def report_failures(
    prog: str, out: Path, work: Callable[[], int | str], *, bus_code: int | None = None
) -> int:
    """Run `work` and return its exit code; a text is printed and is code 0. Print a failure as one line.

    Codes: 2 file or setting; 130 interrupted; of the bus `bus_code`, or 1 with the logs in `out` to look into.
    """
    try:
        done = work()
    except (FileError, FormatError, ConfigError) as error:
        code, failure = 2, str(error)
    except OSError as error:
        code, failure = 2, f"{error.filename or out}: {error.strerror or error}"
    except (ReplayStuckError, BusError) as error:
        code, failure = bus_code or 1, str(error) if bus_code else f"{error}; see {out / 'logs'}"
    except KeyboardInterrupt:
        code, failure = 130, "interrupted"
    else:
        if isinstance(done, int):
            return done
        print(done)
        return 0
    print(f"{prog}: {failure}", file=sys.stderr)
    return code
