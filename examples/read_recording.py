"""Counts the verdicts of a recording by verdict and reason.

    camber replay path/to/drive.toml --out out/drive
    python examples/read_recording.py out/drive/recording.mcap

A damaged recording is read up to the damage. The program then reports the damage on standard error and ends with exit
code 1.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

from camber.formats.drive.recording import RecordingError, read_recording
from camber.schemas.integrity import Verdict

PROG = "read_recording.py"


def count_verdicts(path: Path) -> tuple[Counter[tuple[str, str]], list[RecordingError]]:
    """Return the number of verdicts by verdict and reason, and the errors of a damaged recording."""
    counts: Counter[tuple[str, str]] = Counter()
    errors: list[RecordingError] = []
    for item in read_recording(path, channels=["verdict"]):
        if isinstance(item, RecordingError):
            errors.append(item)
        else:
            verdict: Verdict = item.message
            counts[verdict.verdict, verdict.reason] += 1
    return counts, errors


def main() -> int:
    """Print one line for each verdict and reason, the most frequent first; return the exit code."""
    parser = argparse.ArgumentParser(
        prog=PROG, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="recording.mcap of a replay, or a file of camber record")
    args = parser.parse_args()
    try:
        counts, errors = count_verdicts(args.recording)
    except OSError as error:
        print(f"{PROG}: {args.recording}: {error.strerror}", file=sys.stderr)
        return 2
    for (verdict, reason), count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        print(f"{count:6d} {verdict} {reason}")
    print(f"{counts.total():6d} verdicts")
    for damage in errors:
        print(f"{PROG}: {damage}", file=sys.stderr)
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
