"""Lines of links."""

from __future__ import annotations

import math

from camber.localizer.links.link_line import LinkLine


def line_through(start: tuple[float, float], end: tuple[float, float]) -> LinkLine:
    """Return the line from one point (east, north) to another."""
    alpha = math.atan2(end[1] - start[1], end[0] - start[0])
    return LinkLine(alpha, start[0] * math.sin(alpha) - start[1] * math.cos(alpha))
