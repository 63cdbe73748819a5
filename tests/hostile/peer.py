"""The hostile peer: `python -m hostile.peer ENDPOINT VEHICLE COUNT SEED RATE_HZ [replayed]`; rate 0: at full speed.

Publishes and asks with the priority of what a vehicle drives by, and lets nothing drop on its own side.
"""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from random import Random

import zenoh

from camber.runtime.clock import SystemClock
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from hostile.malformed import Malformed, malformed

_LARGE_EVERY = 2_000
_QUESTION_EVERY = 8
"""Questions are fewer: a service that has 256 of a kind to answer refuses the next."""
_BATCH = 50


def main(endpoint: str, vehicle: str, count: int, seed: int, rate_hz: float, replayed: bool) -> None:
    random = Random(seed)
    made = list(malformed(vehicle, SystemClock().now_ns(), seed, replayed=replayed))
    large = [item for item in made if item.kind == "large"]
    questions = [item for item in made if item.asks and item.kind != "large"]
    messages = [item for item in made if not item.asks and item.kind != "large"]
    session = open_session(ZenohSettings(mode="client", connect=[endpoint]))
    sent: Counter[str] = Counter()
    print("ready", flush=True)
    began = time.monotonic()
    for number in range(count):
        if number % _LARGE_EVERY == _LARGE_EVERY - 1:
            item = random.choice(large)
        elif number % _QUESTION_EVERY == 0:
            item = random.choice(questions)
        else:
            item = random.choice(messages)
        _say(session, item)
        sent[item.kind] += 1
        if rate_hz > 0.0 and number % _BATCH == 0:
            time.sleep(max(0.0, number / rate_hz - (time.monotonic() - began)))
    seconds = time.monotonic() - began
    print(json.dumps({"sent": sum(sent.values()), "seconds": round(seconds, 2), "kinds": sent}), flush=True)
    session.close()


def _say(session: zenoh.Session, item: Malformed) -> None:
    how = {
        "encoding": item.encoding,
        "priority": zenoh.Priority.INTERACTIVE_HIGH,
        "congestion_control": zenoh.CongestionControl.BLOCK,
    }
    if item.asks:
        session.get(item.key, _nobody_listens, payload=item.payload, timeout=1.0, **how)
    else:
        session.put(item.key, item.payload, **how)


def _nobody_listens(reply: zenoh.Reply) -> None:
    pass


if __name__ == "__main__":
    given = sys.argv[1:]
    main(given[0], given[1], int(given[2]), int(given[3]), float(given[4]), given[5:] == ["replayed"])
