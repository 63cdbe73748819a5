"""Map matching: the link that the vehicle is on, by topology and the history of the pose, never by height.

Every plausible (link, direction) is a hypothesis with a weight, the logarithm of its likelihood relative to the
best. A step of the pose adds evidence of distance and heading, and hypotheses pass on only to themselves, their
reverse and the links at their ends: a road that crosses above or runs alongside is never reached without a node.
While several remain plausible the match is *ambiguous* and names them; where no link explains the pose over some
distance there is none (car parks), until the pose has followed one for a while.

CN101360971 takes the link for given. The weights are those of map matching by hidden Markov models (Newson and
Krumm 2009), with evidence per distance, because a link's deviation varies slowly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats, require_array, require_finite

LinkId: TypeAlias = int | str
MatchStatus: TypeAlias = Literal["none", "ambiguous", "matched"]

_SHARP_BEND_RAD: Final = math.radians(25.0)
"""Chosen: at a sharper bend, or an end without a continuation within it, the link's direction is not used."""
# When a hypothesis is plausible. Chosen, from the width of roads and the distance of a link's vertices; what follows is
# measured by `support.tunnel_statistics`.
_LANE_SIGMA_M: Final = 3.0
_PLAUSIBLE_SIGMAS: Final = 3.5
_EVIDENCE_PER_M: Final = 1.0 / 25.0
_U_TURN_PENALTY: Final = 4.0
_STEP_BACK_PENALTY: Final = 1.0
_FORGET_BELOW: Final = 12.0
_AMBIGUOUS_ABOVE: Final = 4.6
_LOST_AFTER_M: Final = 20.0
_REGAIN_AFTER_M: Final = 20.0
_MIN_STEP_M: Final = 1.0
_SEARCH_MARGIN_M: Final = 25.0
_MAX_SEARCH_M: Final = 150.0
_MAX_YAW_SIGMA_RAD: Final = 0.5
_DIRECTION_SIGMA_RAD: Final = math.radians(12.0)
_PLAUSIBLE_ANGLE_RAD: Final = math.radians(60.0)
_SAME_DIRECTION_RAD: Final = math.radians(20.0)


class LinkLine(NamedTuple):
    """The line of a piece of link, CN101360971 eq. (2): `-x sin(alpha) + y cos(alpha) + c = 0`.

    Direction, counter-clockwise from east [rad], and signed normal offset [m], with the origin near the vehicle: the
    derivative of `c` by `alpha` grows with the distance from it.
    """

    alpha_rad: float
    c_m: float

    def offset_m(self, east_m: float, north_m: float) -> float:
        """Return the signed distance of a point from the line, positive to the left of its direction."""
        return -east_m * math.sin(self.alpha_rad) + north_m * math.cos(self.alpha_rad) + self.c_m

    @property
    def normal(self) -> tuple[float, float]:
        """The derivatives of `offset_m` by east and north."""
        return -math.sin(self.alpha_rad), math.cos(self.alpha_rad)

    def shifted(self, east_m: float, north_m: float) -> LinkLine:
        """Return the line in a plane whose origin has moved by (east, north)."""
        return LinkLine(self.alpha_rad, self.offset_m(east_m, north_m))


class _DirectedLink(NamedTuple):
    link: int
    forward: bool

    def reversed(self) -> _DirectedLink:
        return _DirectedLink(self.link, not self.forward)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RoadLink:
    """A piece of road: vertices (n >= 2, 2) east and north [m] from `start_node` to `end_node`, level for stacked
    roads, `sigma_m` of its lateral deviation from the road. Links with `forward_only` are driven along their
    vertices."""

    link_id: LinkId
    start_node: LinkId
    end_node: LinkId
    vertices_m: Floats
    level: int = 0
    sigma_m: float = 2.0
    forward_only: bool = False

    def __post_init__(self) -> None:
        shape = np.shape(self.vertices_m)
        if len(shape) != 2 or shape[0] < 2 or shape[1] != 2:
            raise ValueError(f"vertices_m: expected shape (n >= 2, 2), got {shape}")
        require_array("vertices_m", self.vertices_m, shape)
        if not (math.isfinite(self.sigma_m) and self.sigma_m > 0.0):
            raise ValueError(f"sigma_m: must be finite and positive; got {self.sigma_m}")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkMatch:
    """The current link. `line` is directed along the travel; `level` is None where candidates differ in it;
    `station_m` is the distance along the link from its start, `to_sharp_m` that to the nearest sharp bend or dead
    end."""

    status: MatchStatus
    link_id: LinkId | None = None
    forward: bool = True
    level: int | None = None
    line: LinkLine | None = None
    sigma_m: float = 0.0
    to_sharp_m: float = 0.0
    candidates: tuple[LinkId, ...] = ()
    station_m: float = 0.0


class _LinkProjection(NamedTuple):
    """The nearest point of a link: distance and normal to it, direction and begin of its segment, and its station."""

    distance_m: float
    normal_east: float
    normal_north: float
    alpha_rad: float
    start_east_m: float
    start_north_m: float
    station_m: float


class LinkNetwork:
    """Links as flat arrays of segments, and the links at each node."""

    def __init__(self, links: Sequence[RoadLink]) -> None:
        self.links = tuple(_without_repeats(link) for link in links)
        self._at_node: dict[LinkId, list[_DirectedLink]] = {}
        for index, link in enumerate(self.links):
            self._at_node.setdefault(link.start_node, []).append(_DirectedLink(index, True))
            self._at_node.setdefault(link.end_node, []).append(_DirectedLink(index, False))
        self._flatten()
        self._sharp = [self._sharp_stations(index) for index in range(len(self.links))]

    def _flatten(self) -> None:
        steps = [np.diff(link.vertices_m, axis=0) for link in self.links]
        self._lengths = [np.hypot(step[:, 0], step[:, 1]) for step in steps]
        self._stations = [np.concatenate(([0.0], np.cumsum(length))) for length in self._lengths]
        empty = np.zeros((0, 2))
        self._start = np.concatenate([empty, *(link.vertices_m[:-1] for link in self.links)])
        self._length = np.concatenate([np.zeros(0), *self._lengths])
        self._direction = np.concatenate([empty, *steps]) / self._length[:, None]
        self._station = np.concatenate([np.zeros(0), *(station[:-1] for station in self._stations)])
        self._owner = np.repeat(np.arange(len(self.links)), [len(length) for length in self._lengths])

    def _sharp_stations(self, index: int) -> NDArray[np.float64]:
        """Return stations of the link's sharp bends, and of its ends where no other link continues straight on."""
        step = np.diff(self.links[index].vertices_m, axis=0)
        alpha = np.arctan2(step[:, 1], step[:, 0])
        bend = np.abs((np.diff(alpha) + math.pi) % math.tau - math.pi)
        stations = list(self._stations[index][1:-1][bend > _SHARP_BEND_RAD])
        for forward, station in ((True, self._stations[index][-1]), (False, 0.0)):
            key = _DirectedLink(index, forward)
            heading = self._alpha_at_end(key, at_far_end=True)
            onward = [self._alpha_at_end(k, at_far_end=False) for k in self.successors(key)]
            if not any(abs(wrap_pi(alpha - heading)) <= _SHARP_BEND_RAD for alpha in onward):
                stations.append(station)
        return np.array(stations)

    def _alpha_at_end(self, key: _DirectedLink, *, at_far_end: bool) -> float:
        vertices = self.links[key.link].vertices_m
        a, b = (vertices[-2], vertices[-1]) if key.forward == at_far_end else (vertices[0], vertices[1])
        if not key.forward:
            a, b = b, a
        return math.atan2(b[1] - a[1], b[0] - a[0])

    def successors(self, key: _DirectedLink) -> list[_DirectedLink]:
        """Return the (link, direction) that may follow over the node at the far end."""
        link = self.links[key.link]
        node = link.end_node if key.forward else link.start_node
        return [k for k in self._at_node[node] if k.link != key.link and self.allowed(k)]

    def predecessors(self, key: _DirectedLink) -> list[_DirectedLink]:
        """Return the (link, direction) that may precede over the node at the near end."""
        link = self.links[key.link]
        node = link.start_node if key.forward else link.end_node
        before = (k.reversed() for k in self._at_node[node] if k.link != key.link)
        return [k for k in before if self.allowed(k)]

    def allowed(self, key: _DirectedLink) -> bool:
        """Whether traffic may use the link in this direction."""
        return key.forward or not self.links[key.link].forward_only

    def to_sharp_m(self, link: int, station_m: float) -> float:
        """Return the distance along the link to its nearest sharp vertex, infinite where it has none."""
        sharp = self._sharp[link]
        return float(np.abs(sharp - station_m).min()) if len(sharp) else math.inf

    def projections(self, east_m: float, north_m: float, radius_m: float) -> dict[int, _LinkProjection]:
        """Return the nearest points of the links within the radius, by link index."""
        off_east, off_north = east_m - self._start[:, 0], north_m - self._start[:, 1]
        direction = self._direction
        along = np.clip(off_east * direction[:, 0] + off_north * direction[:, 1], 0.0, self._length)
        off_east -= along * direction[:, 0]
        off_north -= along * direction[:, 1]
        distance = np.hypot(off_east, off_north)
        near = np.flatnonzero(distance <= radius_m)
        nearest: dict[int, _LinkProjection] = {}
        for k in near[np.argsort(distance[near], kind="stable")]:
            owner = int(self._owner[k])
            if owner in nearest:
                continue
            d, (u, v) = float(distance[k]), direction[k]
            normal = (float(off_east[k]) / d, float(off_north[k]) / d) if d > 1e-9 else (-float(v), float(u))
            nearest[owner] = _LinkProjection(
                distance_m=d,
                normal_east=normal[0],
                normal_north=normal[1],
                alpha_rad=math.atan2(v, u),
                start_east_m=float(self._start[k, 0]),
                start_north_m=float(self._start[k, 1]),
                station_m=float(self._station[k] + along[k]),
            )
        return nearest


class LinkMatcher:
    """Matches the vehicle to the network."""

    def __init__(self, network: LinkNetwork) -> None:
        self._network = network
        self.reset()

    def reset(self) -> None:
        """Clear the history, as after a jump of the pose."""
        self._weights: dict[_DirectedLink, float] = {}
        self._travelled_m: float | None = None
        self._lost_m = 0.0
        self._regained_m = math.inf
        self._match = LinkMatch(status="none")

    def replace_network(self, network: LinkNetwork) -> None:
        """Set another part of the map, or another origin; hypotheses on links that remain are kept."""
        index = {link.link_id: k for k, link in enumerate(network.links)}
        old = self._network.links
        self._weights = {
            _DirectedLink(index[old[key.link].link_id], key.forward): weight
            for key, weight in self._weights.items()
            if old[key.link].link_id in index
        }
        self._network = network
        self._match = LinkMatch(status="none")
        if self._travelled_m is not None:
            self._travelled_m -= _MIN_STEP_M

    def step(self, pose: tuple[float, float, float], covariance: Floats, *, travelled_m: float) -> LinkMatch:
        """Return the match at a pose (east, north, yaw; covariance (3, 3)) after a path of `travelled_m` in total.

        Evidence counts per distance: at the same place the match stays the same.
        """
        east_m, north_m, yaw_rad = pose
        require_finite(east_m=east_m, north_m=north_m, yaw_rad=yaw_rad, travelled_m=travelled_m)
        moved = math.inf if self._travelled_m is None else travelled_m - self._travelled_m
        if 0.0 <= moved < _MIN_STEP_M:
            return self._match
        require_array("covariance", covariance, (3, 3))
        self._travelled_m = travelled_m
        self._match = self._next(pose, covariance, moved_m=min(abs(moved), 50.0))
        return self._match

    def _next(self, pose: tuple[float, float, float], p: Floats, *, moved_m: float) -> LinkMatch:
        radius = 3.0 * math.sqrt(max(0.0, float(p[0, 0]) + float(p[1, 1]))) + _SEARCH_MARGIN_M
        if radius > _MAX_SEARCH_M:
            self.reset()
            return self._match
        nearest = self._network.projections(pose[0], pose[1], radius)
        evidence, plausible = self._evidence(nearest, pose[2], p)
        if not self._weights:
            self._weights = {key: evidence[key] for key in plausible}
        else:
            self._pass_on(evidence, min(1.0, moved_m * _EVIDENCE_PER_M))
        self._drop_unlikely()
        alive = plausible & self._weights.keys()
        self._lost_m = 0.0 if alive else self._lost_m + moved_m
        self._regained_m += moved_m if alive else 0.0
        if not alive and (not self._weights or self._lost_m > _LOST_AFTER_M):
            self._weights, self._lost_m, self._regained_m = {}, 0.0, 0.0
        if not alive:
            return LinkMatch(status="none")
        return self._best_match(alive, nearest, float(p[2, 2]))

    def _evidence(
        self, nearest: dict[int, _LinkProjection], yaw: float, p: Floats
    ) -> tuple[dict[_DirectedLink, float], set[_DirectedLink]]:
        """Return the log-likelihood of each (link, direction), and those that are plausible at this pose alone."""
        pee, pnn, pen, pyy = float(p[0, 0]), float(p[1, 1]), float(p[0, 1]), float(p[2, 2])
        evidence: dict[_DirectedLink, float] = {}
        plausible: set[_DirectedLink] = set()
        heading_var = pyy + _DIRECTION_SIGMA_RAD**2
        widest = _PLAUSIBLE_ANGLE_RAD + 3.0 * math.sqrt(pyy)
        for link, point in nearest.items():
            u, v = point.normal_east, point.normal_north
            link_var = self._network.links[link].sigma_m ** 2 + _LANE_SIGMA_M**2
            variance = link_var + u * u * pee + v * v * pnn + 2.0 * u * v * pen
            d2 = point.distance_m**2 / variance
            for key in (_DirectedLink(link, True), _DirectedLink(link, False)):
                if not self._network.allowed(key):
                    continue
                turn = abs(wrap_pi(yaw - point.alpha_rad - (0.0 if key.forward else math.pi)))
                evidence[key] = -0.5 * (min(d2, 40.0) + min(turn * turn / heading_var, 20.0))
                if d2 <= _PLAUSIBLE_SIGMAS**2 and turn <= widest:
                    plausible.add(key)
        return evidence, plausible

    def _pass_on(self, evidence: dict[_DirectedLink, float], share: float) -> None:
        """Pass the weights on along the topology, and add a share of the evidence."""
        prior = dict(self._weights)

        def offer(key: _DirectedLink, weight: float) -> None:
            if key in evidence and weight > prior.get(key, -math.inf):
                prior[key] = weight

        for key, weight in self._weights.items():
            offer(key.reversed(), weight - _U_TURN_PENALTY)
            for k in self._network.successors(key):
                offer(k, weight)
            for k in self._network.predecessors(key):
                offer(k, weight - _STEP_BACK_PENALTY)
        self._weights = {key: weight + share * evidence.get(key, -30.0) for key, weight in prior.items()}

    def _drop_unlikely(self) -> None:
        if not self._weights:
            return
        best = max(self._weights.values())
        floor = best - _FORGET_BELOW
        self._weights = {key: w - best for key, w in self._weights.items() if w >= floor}

    def _best_match(
        self, alive: set[_DirectedLink], nearest: dict[int, _LinkProjection], yaw_var: float
    ) -> LinkMatch:
        links = self._network.links
        best = max(alive, key=lambda key: (self._weights[key], -nearest[key.link].distance_m, key))
        threshold = self._weights[best] - _AMBIGUOUS_ABOVE
        near = sorted((k for k in alive if self._weights[k] >= threshold), key=lambda k: -self._weights[k])
        rivals = [k for k in near if not self._same_road(best, k, nearest)]
        levels = {links[k.link].level for k in near}
        point = nearest[best.link]
        alpha = point.alpha_rad if best.forward else wrap_pi(point.alpha_rad + math.pi)
        c = point.start_east_m * math.sin(alpha) - point.start_north_m * math.cos(alpha)
        settled = not rivals and self._regained_m >= _REGAIN_AFTER_M
        return LinkMatch(
            status="matched" if settled else "ambiguous",
            link_id=links[best.link].link_id,
            forward=best.forward,
            level=levels.pop() if len(levels) == 1 else None,
            line=LinkLine(alpha, c) if math.sqrt(yaw_var) <= _MAX_YAW_SIGMA_RAD else None,
            sigma_m=links[best.link].sigma_m,
            to_sharp_m=self._network.to_sharp_m(best.link, point.station_m),
            candidates=tuple(dict.fromkeys(links[k.link].link_id for k in near)),
            station_m=point.station_m,
        )

    def _same_road(self, a: _DirectedLink, b: _DirectedLink, nearest: dict[int, _LinkProjection]) -> bool:
        """Whether two hypotheses are one road: one link, or one going straight on into the other."""
        links = self._network.links
        if a.link == b.link:
            return True
        if links[a.link].level != links[b.link].level:
            return False
        turn = nearest[a.link].alpha_rad - nearest[b.link].alpha_rad
        turn += 0.0 if a.forward == b.forward else math.pi
        if abs(wrap_pi(turn)) > _SAME_DIRECTION_RAD:
            return False
        return b in self._network.successors(a) or a in self._network.successors(b)


def _without_repeats(link: RoadLink) -> RoadLink:
    """Return the link without vertices that coincide with the one before; ValueError if no length remains."""
    step = np.diff(link.vertices_m, axis=0)
    keep = np.concatenate(([True], np.hypot(step[:, 0], step[:, 1]) > 1e-6))
    if keep.sum() < 2:
        raise ValueError(f"vertices_m: link {link.link_id} has no length")
    return link if keep.all() else replace(link, vertices_m=link.vertices_m[keep])
