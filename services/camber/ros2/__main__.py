"""`python -m camber.ros2`."""

from camber.ros2.service import SERVICE
from camber.runtime.run import run

raise SystemExit(run(SERVICE))
