"""`python -m camber.sensors`."""

from camber.runtime.run import run
from camber.sensors.service import SERVICE

raise SystemExit(run(SERVICE))
