"""`python -m camber.gnss`."""

import sys

from camber.gnss.service import SERVICE
from camber.runtime.run import run
from camber.transport.serial_ports import describe_ports

if "--list-ports" in sys.argv[1:]:
    print(describe_ports())
    raise SystemExit(0)
raise SystemExit(run(SERVICE))
