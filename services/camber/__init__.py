"""Camber as a library: positions from raw observations, the judge, drives, a live vehicle, the road map.

What is listed in `__all__` is stable: see docs/library.md. All other modules may change with any version.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import extend_path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from camber.api.columns import Columns
    from camber.api.drive_replay import ReplayResult, replay_drive
    from camber.api.live_vehicle import LiveVehicle, connect
    from camber.api.message_judge import Judgements, judge
    from camber.api.message_judge import MessageJudge as Judge
    from camber.api.road_elevations import Map
    from camber.api.rtk_solution import solve

# In a checkout the package lies in two source roots. In place: import-linter reads the list of the module's spec.
__path__[:] = extend_path(__path__, __name__)

_DEFINITIONS = {
    "Columns": "columns.Columns",
    "Judge": "message_judge.MessageJudge",
    "Judgements": "message_judge.Judgements",
    "LiveVehicle": "live_vehicle.LiveVehicle",
    "Map": "road_elevations.Map",
    "ReplayResult": "drive_replay.ReplayResult",
    "connect": "live_vehicle.connect",
    "judge": "message_judge.judge",
    "replay_drive": "drive_replay.replay_drive",
    "solve": "rtk_solution.solve",
}
"""Public names and where `camber.api` defines them. Modules are imported on first use: the engine takes a second."""

__all__ = [
    "Columns",
    "Judge",
    "Judgements",
    "LiveVehicle",
    "Map",
    "ReplayResult",
    "connect",
    "judge",
    "replay_drive",
    "solve",
]


def __getattr__(name: str) -> Any:
    if name not in _DEFINITIONS:
        raise AttributeError(f"module 'camber' has no attribute {name!r}")
    module, _, attribute = _DEFINITIONS[name].partition(".")
    return getattr(import_module(f"camber.api.{module}"), attribute)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
