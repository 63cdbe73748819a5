"""`python -m camber.localizer`."""

from camber.localizer.service import SERVICE
from camber.runtime.run import run

raise SystemExit(run(SERVICE))
