"""`python -m camber.integrity`."""

from camber.integrity.service import SERVICE
from camber.runtime.run import run

raise SystemExit(run(SERVICE))
