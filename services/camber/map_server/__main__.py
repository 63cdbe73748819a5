"""`python -m camber.map_server`."""

from camber.map_server.service import SERVICE
from camber.runtime.run import run

if __name__ == "__main__":
    raise SystemExit(run(SERVICE))
