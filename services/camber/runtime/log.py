"""Structured logs to standard error; a full disk behind it stops the log, never the service."""

from __future__ import annotations

import sys
from typing import Any

import structlog

from camber.schemas.health import LogLevel

_LEVELS = {"debug": 10, "info": 20, "warning": 30, "error": 40}


class _StandardError:
    """Standard error that swallows what cannot be written."""

    def write(self, text: str) -> int:
        try:
            return sys.stderr.write(text)
        except OSError:
            return 0

    def flush(self) -> None:
        try:
            sys.stderr.flush()
        except OSError:
            return


class TemporaryLogLevel:
    """The level that the settings name, and another one for a while. Times are monotonic, in seconds."""

    def __init__(self, level: LogLevel) -> None:
        self.level = level
        self._configured = level
        self._until_s = float("inf")

    def change(self, level: LogLevel, for_s: float, now_s: float) -> None:
        """Another level, until that time is over; the last word holds."""
        self.level = level
        self._until_s = now_s + for_s

    def fall_back(self, now_s: float) -> bool:
        """Is the time over? Then the level is that of the settings again."""
        if now_s < self._until_s:
            return False
        self.level, self._until_s = self._configured, float("inf")
        return True


def make_logger(service: str, *, level: str, form: str) -> Any:
    """A logger bound to the service's name."""
    renderer: Any = (
        structlog.processors.JSONRenderer()
        if form == "json"
        else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty())
    )
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(_LEVELS[level]),
        logger_factory=structlog.PrintLoggerFactory(_StandardError()),  # type: ignore[arg-type]
        cache_logger_on_first_use=False,
    )
    return structlog.get_logger().bind(service=service)
