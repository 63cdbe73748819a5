"""`python -m camber.map_update`."""

from camber.map_update.service import MapUpdateService
from camber.runtime.run import run

raise SystemExit(run(MapUpdateService))
