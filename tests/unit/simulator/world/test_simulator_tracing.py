"""Rays meet shapes where geometry says, whatever the shapes are and wherever the rays come from."""

from __future__ import annotations

import dataclasses
import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.simulator.scene import Floats, Material, Shapes
from camber.simulator.world.ray_tracing import ShapeTracer


def unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def random_shapes(rng: np.random.Generator, count: int = 40, extent_m: float = 50.0) -> Shapes:
    def places() -> Floats:
        return np.column_stack((rng.uniform(-extent_m, extent_m, (count, 2)), rng.uniform(-3.0, 10.0, count)))

    boxes = np.column_stack((places(), rng.uniform(0.5, 12.0, (count, 3)), rng.uniform(-4.0, 4.0, count)))
    cylinders = np.column_stack((places(), rng.uniform(0.05, 3.0, count), rng.uniform(0.5, 12.0, count)))
    crowns = np.column_stack((places(), rng.uniform(0.5, 5.0, (count, 2))))
    triangles = places()[:, None, :] + rng.uniform(-15.0, 15.0, (count, 3, 3))
    return Shapes.of(boxes=boxes, cylinders=cylinders, crowns=crowns, triangles=triangles)


def random_rays(rng: np.random.Generator, count: int, extent_m: float = 90.0) -> tuple[Floats, Floats]:
    origin = np.column_stack((rng.uniform(-extent_m, extent_m, (count, 2)), rng.uniform(-5.0, 25.0, count)))
    direction = unit(rng.standard_normal((count, 3)) * (1.0, 1.0, 0.4))
    direction[::7, 2] = 0.0  # level rays, and such along an axis
    direction[::14, 0] = 0.0
    direction[5::11] = (0.0, 0.0, -1.0)
    return origin, unit(direction)


def oracle_spans(shapes: Shapes, origin: Floats, direction: Floats) -> dict[str, tuple[Floats, Floats]]:
    """Spans (rays, shapes) inside each solid, by half spaces and quadrics over all shapes at once."""
    boxes, cylinders, crowns = shapes.boxes_m, shapes.cylinders_m, shapes.crowns_m
    c, s, zero, one = np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes)), np.ones(len(boxes))
    axes = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    faces = np.concatenate((axes, -axes), axis=1)
    centre = boxes[:, :3] + boxes[:, 5:6] * (0.0, 0.0, 0.5)
    reach = np.tile(boxes[:, 3:6] * (1.0, 1.0, 0.5), 2)
    caps = np.tile([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], (len(cylinders), 1, 1))
    ends = np.column_stack((cylinders[:, 2] + cylinders[:, 4], -cylinders[:, 2]))
    flat = np.tile([1.0, 1.0, 0.0], (len(cylinders), 1))
    stretch = np.column_stack((np.ones((len(crowns), 2)), crowns[:, 3] / crowns[:, 4]))
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = np.einsum("sfk,sk->sf", faces, centre) + reach
        low, high = half_spaces(caps, ends, origin, direction)
        side = quadric(cylinders[:, :3], cylinders[:, 3], flat, origin, direction)
        return {
            "boxes": half_spaces(faces, offset, origin, direction),
            "cylinders": (np.maximum(low, side[0]), np.minimum(high, side[1])),
            "crowns": quadric(crowns[:, :3], crowns[:, 3], stretch, origin, direction),
        }


def half_spaces(normal: Floats, offset: Floats, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
    speed = np.einsum("sfk,rk->rsf", normal, direction)
    gap = offset - np.einsum("sfk,rk->rsf", normal, origin)
    t = gap / speed
    low = np.where(speed < 0.0, t, -np.inf)
    high = np.where(speed > 0.0, t, np.inf)
    outside = (speed == 0.0) & (gap < 0.0)
    return np.where(outside, np.inf, low).max(axis=2), np.where(outside, -np.inf, high).min(axis=2)


def quadric(
    centre: Floats, radius: Floats, scale: Floats, origin: Floats, direction: Floats
) -> tuple[Floats, Floats]:
    p = (origin[:, None, :] - centre) * scale
    d = direction[:, None, :] * scale
    a, b = np.sum(d * d, axis=2), np.sum(p * d, axis=2)
    c = np.sum(p * p, axis=2) - radius**2
    root2 = b * b - a * c
    root = np.sqrt(np.maximum(root2, 0.0))
    low, high = (-b - root) / a, (-b + root) / a
    along_axis = a == 0.0
    low = np.where(along_axis, np.where(c <= 0.0, -np.inf, np.inf), np.where(root2 < 0.0, np.inf, low))
    high = np.where(along_axis, np.where(c <= 0.0, np.inf, -np.inf), np.where(root2 < 0.0, -np.inf, high))
    return low, high


def oracle_triangles(shapes: Shapes, origin: Floats, direction: Floats) -> Floats:
    """Distance (rays, triangles), by the plane and three signed areas."""
    a, b, c = (shapes.triangles_m[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("sk,rsk->rs", normal, a - origin[:, None]) / (direction @ normal.T)
        at = origin[:, None] + t[..., None] * direction[:, None]
    inside = np.ones(t.shape, bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("rsk,sk->rs", np.cross(q - p, at - p), normal) >= 0.0
    return np.where(inside & np.isfinite(t), t, np.inf)


def surfaces(shapes: Shapes, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Distance to the first surface of each solid, triangles included: without crowns, and of crowns."""
    spans = oracle_spans(shapes, origin, direction)
    first = {
        name: np.where(low <= high, np.where(low > 0.0, low, np.where(high > 0.0, high, np.inf)), np.inf)
        for name, (low, high) in spans.items()
    }
    flat = oracle_triangles(shapes, origin, direction)
    hard = np.concatenate((first["boxes"], first["cylinders"], np.where(flat > 0.0, flat, np.inf)), axis=1)
    return hard, first["crowns"]


@pytest.mark.parametrize(("seed", "cell_m"), list(itertools.product(range(3), (2.5, 17.0))))
def test_hits_agree_with_an_oracle_that_looks_at_every_shape(seed: int, cell_m: float) -> None:
    rng = np.random.default_rng(seed)
    shapes = random_shapes(rng)
    origin, direction = random_rays(rng, 2000, 60.0)
    hard, crowns = surfaces(shapes, origin, direction)
    expected = np.concatenate((hard, crowns), axis=1).min(axis=1)
    expected[expected > 40.0] = np.inf
    tracer = ShapeTracer(shapes, cell_m)
    hits = tracer.first_hits(origin, direction, 40.0)
    met = np.isfinite(expected)
    assert met.mean() > 0.2
    assert (np.isfinite(hard.min(axis=1)) & ~met).sum() > 50  # beyond the range
    np.testing.assert_array_equal(np.isfinite(hits.distance_m), met)
    np.testing.assert_allclose(hits.distance_m[met], expected[met], atol=1e-9)
    nearest = hard.min(axis=1)
    np.testing.assert_array_equal(tracer.blocked(origin, direction, 40.0), nearest <= 40.0)
    kind = np.concatenate((hard, crowns), axis=1).argmin(axis=1) // 40
    materials = np.array([Material.BUILDING, Material.POLE, Material.ROAD, Material.TREE])
    np.testing.assert_array_equal(hits.material, np.where(met, materials[kind], -1))


@pytest.mark.parametrize("seed", range(2))
def test_normals_are_unit_vectors_towards_the_origin_and_square_to_the_surface(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    shapes = random_shapes(rng)
    origin, direction = random_rays(rng, 3000)
    tracer = ShapeTracer(shapes)
    hits = tracer.first_hits(origin, direction, 200.0)
    met = np.isfinite(hits.distance_m)
    np.testing.assert_allclose(np.linalg.norm(hits.normal[met], axis=1), 1.0, atol=1e-12)
    assert not hits.normal[~met].any()
    assert (np.sum(hits.normal * direction, axis=1)[met] <= 0.0).all()
    # The surface near the hit, by two other rays through points next to it: their difference is square to the normal.
    at = origin[met] + hits.distance_m[met, None] * direction[met]
    for k in range(2):
        near_by = unit(direction[met] + 1e-6 * rng.standard_normal((len(at), 3)))
        other = tracer.first_hits(origin[met], near_by, 200.0)
        step = origin[met] + other.distance_m[:, None] * near_by - at
        near = np.linalg.norm(step, axis=1) < 0.01
        slip = np.abs(np.sum(step[near] * hits.normal[met][near], axis=1))
        # Rounded shapes bend away by step² / 2r; at the edge of a box the other ray may meet another face.
        assert np.mean(slip < 1e-3 * np.linalg.norm(step[near], axis=1) + 1e-9) > 0.995, k


@pytest.mark.parametrize("seed", range(2))
def test_metres_of_crowns_are_those_of_points_counted_along_the_ray(seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    shapes = random_shapes(rng, count=30, extent_m=15.0)
    origin, direction = random_rays(rng, 300, 20.0)
    steps = (np.arange(2000) + 0.5) * 0.01
    crowns = shapes.crowns_m
    counted = np.zeros(len(origin))
    for i in range(len(origin)):
        p = origin[i] + steps[:, None] * direction[i]
        inside = np.zeros(len(steps), bool)
        for e, n, up, horizontal, vertical in crowns:
            plan2 = ((p[:, 0] - e) ** 2 + (p[:, 1] - n) ** 2) / horizontal**2
            inside |= plan2 + (p[:, 2] - up) ** 2 / vertical**2 < 1.0
        counted[i] = inside.sum() * 0.01
    assert (counted > 5.0).sum() > 10
    metres = ShapeTracer(shapes).through_crowns_m(origin, direction, 20.0)
    np.testing.assert_allclose(metres, counted, atol=0.05)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-3.0, 3.0),
    st.tuples(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0), st.floats(-50.0, 50.0)),
)
def test_turning_and_moving_world_and_rays_together_changes_no_distance(
    seed: int, turn: float, shift: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(seed)
    shapes = random_shapes(rng, count=6, extent_m=30.0)
    origin, direction = random_rays(rng, 200, 40.0)
    c, s = np.cos(turn), np.sin(turn)
    turning = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # rows are turned

    def moved(columns: Floats) -> Floats:
        rest = columns.copy()
        rest[..., :3] = columns[..., :3] @ turning + np.array(shift)
        return rest

    boxes = moved(shapes.boxes_m)
    boxes[:, 6] += turn
    solids = {"cylinders_m": moved(shapes.cylinders_m), "crowns_m": moved(shapes.crowns_m)}
    other = dataclasses.replace(shapes, boxes_m=boxes, triangles_m=moved(shapes.triangles_m), **solids)
    before = ShapeTracer(shapes).first_hits(origin, direction, 80.0)
    after = ShapeTracer(other).first_hits(moved(origin), direction @ turning, 80.0)
    # Rays that graze an edge may fall to either side of it by rounding.
    same = np.isclose(before.distance_m, after.distance_m, atol=1e-6)
    assert (~same).sum() <= 1


def test_no_ray_slips_through_the_seams_of_a_mesh() -> None:
    rng = np.random.default_rng(3)
    e, n = np.meshgrid(np.linspace(-40, 40, 33), np.linspace(-40, 40, 33), indexing="ij")
    up = 0.3 * rng.standard_normal(e.shape)
    p = np.stack((e, n, up), axis=2)
    one = np.stack((p[:-1, :-1], p[1:, :-1], p[1:, 1:]), axis=2).reshape(-1, 3, 3)
    two = np.stack((p[:-1, :-1], p[1:, 1:], p[:-1, 1:]), axis=2).reshape(-1, 3, 3)
    tracer = ShapeTracer(Shapes.of(triangles=np.concatenate((one, two))))
    corners = p[1:-1, 1:-1].reshape(-1, 3)
    origin = np.tile((0.7, 0.3, 60.0), (len(corners), 1))
    hits = tracer.first_hits(origin, unit(corners - origin), 200.0)  # aimed at the seams themselves
    np.testing.assert_allclose(hits.distance_m, np.linalg.norm(corners - origin, axis=1), atol=1e-6)


def test_an_empty_district_stops_nothing() -> None:
    origin, direction = random_rays(np.random.default_rng(0), 50)
    tracer = ShapeTracer(Shapes.of())
    assert np.isinf(tracer.first_hits(origin, direction, 100.0).distance_m).all()
    assert not tracer.blocked(origin, direction, 100.0).any()
    assert not tracer.through_crowns_m(origin, direction, 100.0).any()


def test_rays_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected both \(n, 3\)"):
        ShapeTracer(Shapes.of()).first_hits(np.zeros((2, 3)), np.zeros((3, 3)), 10.0)


def test_two_threads_get_what_one_gets() -> None:
    rng = np.random.default_rng(8)
    tracer = ShapeTracer(random_shapes(rng, 50))
    origin, direction = random_rays(rng, 20_000)
    alone = tracer.first_hits(origin, direction, 100.0).distance_m
    with ThreadPoolExecutor(2) as pool:
        halves = [pool.submit(tracer.first_hits, origin[k::2], direction[k::2], 100.0) for k in range(2)]
        parts = [half.result().distance_m for half in halves]
    np.testing.assert_array_equal(parts[0], alone[0::2])
    np.testing.assert_array_equal(parts[1], alone[1::2])
