"""`python -m camber.gnss`."""

from camber.gnss.service import SERVICE
from camber.runtime.run import run

raise SystemExit(run(SERVICE))
