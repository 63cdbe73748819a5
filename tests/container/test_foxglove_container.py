"""`camber foxglove` from its container: a viewer on this machine connects, and others cannot."""

from __future__ import annotations

import json

import pytest

from support.containers import free_port, skip_without_engine
from support.containers import stack as started_stack

pytestmark = [pytest.mark.container, pytest.mark.slow]
connect = pytest.importorskip("websockets.sync.client").connect


def test_a_viewer_on_this_machine_is_shown_the_vehicle() -> None:
    skip_without_engine()
    port = free_port()
    with started_stack("foxglove", "foxglove", foxglove_port=port, vehicle="car-1") as stack:
        stack.compose("up", "--detach", "--wait", "--wait-timeout", "60", timeout_s=90.0)
        assert stack.compose("port", "foxglove", "8765").strip() == f"127.0.0.1:{port}"
        with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], open_timeout=10.0) as viewer:
            server = json.loads(viewer.recv(timeout=10.0))
        assert (server["op"], server["name"]) == ("serverInfo", "Camber: car-1")
        (service,) = json.loads(stack.compose("config", "--format", "json"))["services"].values()
        assert (service["cap_drop"], service["read_only"]) == (["ALL"], True)
