"""How a service lives: settings, bus, inboxes, health, an orderly end. Alone in importing zenoh."""

import os

# One thread for each of Zenoh's jobs instead of one or two per core: six services on two cores otherwise spend
# much of their time on waking one another's threads. Read by Zenoh when it is first imported.
_POOLS = ", ".join(f"{pool}: (worker_threads: 1)" for pool in ("app", "acc", "tx", "rx", "net"))
os.environ.setdefault("ZENOH_RUNTIME", f"({_POOLS})")
