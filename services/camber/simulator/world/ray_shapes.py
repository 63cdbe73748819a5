"""Where one ray meets one shape: the span of it inside a solid, or its distance to a triangle.

A ray is an origin and a unit direction; solids are convex, so that what a ray passes of one is a single span
(t_in, t_out); an empty span has t_in > t_out. Shapes are rows k of a table: taking a row out of it would cost more than
the test. Slabs after Kay & Kajiya 1986 ("Ray tracing complex scenes"), the triangle after Möller & Trumbore 1997
("Fast, minimum storage ray/triangle intersection").
"""

from __future__ import annotations

import math

from camber.compiled.decorator import compiled
from camber.simulator.scene import Floats

_EDGE = 1.0e-9  # chosen: a triangle reaches this share beyond its edges, so that no ray slips through a seam
_MISSED = (math.inf, -math.inf)

Ray = tuple[float, float, float, float, float, float]
"""Origin and unit direction."""
Point = tuple[float, float, float]


@compiled
def _slab(origin: float, step: float, low: float, high: float) -> tuple[float, float]:
    if step == 0.0:
        return (-math.inf, math.inf) if low <= origin <= high else _MISSED
    a, b = (low - origin) / step, (high - origin) / step
    return (a, b) if a < b else (b, a)


@compiled
def box_span(table: Floats, k: int, ray: Ray) -> tuple[float, float]:
    """Span in an upright box: east, north, base of its centre, half length, half width, height, cos, sin of yaw."""
    x, y, z, dx, dy, dz = ray
    ex, ey = x - table[k, 0], y - table[k, 1]
    c, s = table[k, 6], table[k, 7]
    u0, u1 = _slab(c * ex + s * ey, c * dx + s * dy, -table[k, 3], table[k, 3])
    v0, v1 = _slab(c * ey - s * ex, c * dy - s * dx, -table[k, 4], table[k, 4])
    w0, w1 = _slab(z - table[k, 2], dz, 0.0, table[k, 5])
    return max(u0, v0, w0), min(u1, v1, w1)


@compiled
def cylinder_span(table: Floats, k: int, ray: Ray) -> tuple[float, float]:
    """Span in an upright cylinder: east, north, base, radius, height."""
    x, y, z, dx, dy, dz = ray
    w0, w1 = _slab(z - table[k, 2], dz, 0.0, table[k, 4])
    ex, ey = x - table[k, 0], y - table[k, 1]
    a = dx * dx + dy * dy
    c = ex * ex + ey * ey - table[k, 3] * table[k, 3]
    if a == 0.0:
        return _MISSED if c > 0.0 else (w0, w1)
    b = ex * dx + ey * dy
    root2 = b * b - a * c
    if root2 < 0.0:
        return _MISSED
    root = math.sqrt(root2)
    return max(w0, (-b - root) / a), min(w1, (-b + root) / a)


@compiled
def crown_span(table: Floats, k: int, ray: Ray) -> tuple[float, float]:
    """Span in an ellipsoid: east, north, up of its centre, horizontal and vertical radius."""
    x, y, z, dx, dy, dz = ray
    r = table[k, 3] / table[k, 4]
    ex, ey, ez = x - table[k, 0], y - table[k, 1], (z - table[k, 2]) * r
    fz = dz * r
    a = dx * dx + dy * dy + fz * fz
    b = ex * dx + ey * dy + ez * fz
    c = ex * ex + ey * ey + ez * ez - table[k, 3] * table[k, 3]
    root2 = b * b - a * c
    if root2 < 0.0:
        return _MISSED
    root = math.sqrt(root2)
    return (-b - root) / a, (-b + root) / a


@compiled
def triangle_distance(table: Floats, k: int, ray: Ray) -> float:
    """Distance to a triangle, infinite where it is missed; its row is a corner and the edges to the two others."""
    x, y, z, dx, dy, dz = ray
    ax, ay, az = table[k, 3], table[k, 4], table[k, 5]
    bx, by, bz = table[k, 6], table[k, 7], table[k, 8]
    px, py, pz = dy * bz - dz * by, dz * bx - dx * bz, dx * by - dy * bx
    det = ax * px + ay * py + az * pz
    if det == 0.0:
        return math.inf
    inverse = 1.0 / det
    tx, ty, tz = x - table[k, 0], y - table[k, 1], z - table[k, 2]
    u = (tx * px + ty * py + tz * pz) * inverse
    if u < -_EDGE or u > 1.0 + _EDGE:
        return math.inf
    qx, qy, qz = ty * az - tz * ay, tz * ax - tx * az, tx * ay - ty * ax
    v = (dx * qx + dy * qy + dz * qz) * inverse
    if v < -_EDGE or u + v > 1.0 + _EDGE:
        return math.inf
    distance: float = (bx * qx + by * qy + bz * qz) * inverse
    return distance


@compiled
def box_normal(table: Floats, k: int, point: Point) -> Point:
    """Outward normal of a box at a point on its surface: that of the face which the point is nearest to."""
    x, y, z = point
    ex, ey = x - table[k, 0], y - table[k, 1]
    c, s = table[k, 6], table[k, 7]
    u, v = c * ex + s * ey, c * ey - s * ex
    du, dv = abs(abs(u) - table[k, 3]), abs(abs(v) - table[k, 4])
    dw = min(abs(z - table[k, 2]), abs(z - table[k, 2] - table[k, 5]))
    if du <= dv and du <= dw:
        sign = 1.0 if u > 0.0 else -1.0
        return sign * c, sign * s, 0.0
    if dv <= dw:
        sign = 1.0 if v > 0.0 else -1.0
        return -sign * s, sign * c, 0.0
    return 0.0, 0.0, 1.0 if z - table[k, 2] > 0.5 * table[k, 5] else -1.0


@compiled
def cylinder_normal(table: Floats, k: int, point: Point) -> Point:
    """Outward normal of a cylinder at a point on its surface."""
    x, y, z = point
    ex, ey = x - table[k, 0], y - table[k, 1]
    away = math.sqrt(ex * ex + ey * ey)
    dw = min(abs(z - table[k, 2]), abs(z - table[k, 2] - table[k, 4]))
    if abs(away - table[k, 3]) <= dw:
        return ex / away, ey / away, 0.0
    return 0.0, 0.0, 1.0 if z - table[k, 2] > 0.5 * table[k, 4] else -1.0


@compiled
def crown_normal(table: Floats, k: int, point: Point) -> Point:
    """Outward normal of an ellipsoid at a point on its surface."""
    x, y, z = point
    r2 = (table[k, 3] / table[k, 4]) ** 2
    ex, ey, ez = x - table[k, 0], y - table[k, 1], (z - table[k, 2]) * r2
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    return ex / length, ey / length, ez / length


@compiled
def triangle_normal(table: Floats, k: int) -> Point:
    """Unit normal of a triangle; zero where it has no area, which no ray meets."""
    ax, ay, az = table[k, 3], table[k, 4], table[k, 5]
    bx, by, bz = table[k, 6], table[k, 7], table[k, 8]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = max(math.sqrt(nx * nx + ny * ny + nz * nz), 1.0e-300)
    return nx / length, ny / length, nz / length
