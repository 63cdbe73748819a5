"""`python -m camber.map_server`."""

from camber.map_server.service import MapServerService
from camber.runtime.run import run

if __name__ == "__main__":
    raise SystemExit(run(MapServerService))
