"""What the tests of faults have measured: printed, and kept in the file that FAULTS_OUT names, a line of JSON each."""

from __future__ import annotations

import json
import os
from pathlib import Path

LONG = os.environ.get("FAULTS") == "long"
"""`make faults`: outages as long as they are promised for, and not scaled to what a test of every day may take."""


def measured(fault: str, **figures: object) -> None:
    """Keep the figures of a row."""
    shown = ", ".join(f"{name} {value:.2f}" if isinstance(value, float) else f"{name} {value}"
                      for name, value in figures.items())  # fmt: skip
    print(f"{fault}: {shown}", flush=True)
    path = os.environ.get("FAULTS_OUT")
    if path:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with Path(path).open("a") as file:
            file.write(json.dumps({"fault": fault, **figures}) + "\n")
