"""`python -m camber.antenna_height`."""

from camber.antenna_height.service import SERVICE
from camber.runtime.run import run

raise SystemExit(run(SERVICE))
