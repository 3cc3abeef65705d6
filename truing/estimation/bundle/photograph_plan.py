"""Plan photographs: choose camera stations out of candidates so that targets reach the wanted precision.

Greedy selection: the station that helps most is added, then each is exchanged while this helps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.datum import movements
from truing.estimation.bundle.network import Bars
from truing.estimation.bundle.planning import (
    CameraLimits,
    PlannedNetwork,
    PlannedObject,
    PredictedPrecision,
    Stations,
    filling_distance,
    predict,
    shells,
    station_information,
    useful_stations,
    visible,
    weak_prior,
)

Progress = Callable[[int, int], None]

_SHELLS = (1.05, 1.35, 1.75)  # relative to the distance from which the object fills the format
_AT_ONCE = 64
_LEAST_SAVING = 1e-3  # least relative decrease of the mean variance for an exchange
_MOST_POINTS = 48


@dataclass(frozen=True)
class PlanOptions:
    """Options of a plan: most stations; standard deviation in mm to reach (None: use all stations); distances,
    elevations, directions and rolls of the candidates; limits of the camera."""

    stations: int = 12
    target_sigma_mm: float | None = None
    nearest_mm: float | None = None
    farthest_mm: float | None = None
    elevation_deg: tuple[float, float] = (0.0, 80.0)
    directions: int = 60
    incidence_deg: float = 60.0
    least_px: float = 8.0


@dataclass(frozen=True)
class PlannedTargets:
    """Targets to photograph: body and name, positions (P, 3) in m, normals (P, 3), diameters (P,) in m."""

    body: tuple[str, ...]
    name: tuple[str, ...]
    layout: PlannedObject


@dataclass(frozen=True)
class PhotographPlan:
    """Chosen stations in the order in which to take them, the targets they see, and the predicted precision.

    curve: (number of stations, worst, mean standard deviation in m) for fewer and more stations.
    """

    planned: PlannedNetwork
    targets: PlannedTargets
    stations: Stations
    seen: Mask
    prediction: PredictedPrecision
    curve: tuple[tuple[int, float, float], ...]
    candidates: int
    options: PlanOptions
    reference: str | None

    @property
    def worst_mm(self) -> float:
        """Largest standard deviation of a determined target, mm."""
        return 1e3 * float(np.nanmax(self.prediction.sigma))

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Targets that fewer than two stations see."""
        lost = np.flatnonzero(np.isnan(self.prediction.sigma))
        return tuple(f"{self.targets.body[i]}/{self.targets.name[i]}" for i in lost)

    @property
    def reaches(self) -> bool:
        """True if every target reaches the wanted precision."""
        wanted = self.options.target_sigma_mm
        return not self.undetermined and (wanted is None or self.worst_mm <= wanted)


def plan_photographs(
    planned: PlannedNetwork, targets: PlannedTargets, settings: PlanOptions, reference: str | None, progress: Progress
) -> PhotographPlan:
    """Return the plan; raises ValueError if no station sees enough targets, or if the stations form no network."""
    stations = _candidates(planned, settings)
    nearest = 0.0 if settings.nearest_mm is None else 1e-3 * settings.nearest_mm
    farthest = np.inf if settings.farthest_mm is None else 1e-3 * settings.farthest_mm
    limits = CameraLimits(nearest, farthest, np.radians(settings.incidence_deg), settings.least_px)
    seen = visible(planned.camera, planned.interior, stations, planned.layout, limits)
    of_use = useful_stations(seen)
    if len(of_use) < 2:
        raise ValueError(
            f"found {len(of_use)} of {stations.count:,} stations with four visible targets, expected 2 or more"
        )
    stations, seen = stations.subset(of_use), seen[of_use]
    some = spread_points(planned.layout.points)
    search = _restricted(planned, some)
    candidates = StationCandidates(
        station_information(search, stations, seen[:, some]),
        weak_prior(search),
        search.layout.points,
        len(search.bars.bar) > 0,
    )
    order = one_by_one(candidates, settings.stations, progress)
    curve = _curve(planned, stations, seen, order)
    first = order[: _sufficient_stations(curve, settings, len(order))]
    chosen = _with_the_better_worst(planned, stations, seen, (first, exchanged(candidates, first, progress)))
    chosen = _in_order_round(stations, chosen, planned.layout.middle)
    prediction = predict(planned, stations.subset(chosen), seen[chosen])
    if prediction is None:
        made_by = "1 station" if len(chosen) == 1 else f"{len(chosen):,} stations"
        raise ValueError(f"{made_by} determine no network, expected more stations or more common targets")
    return PhotographPlan(
        planned, targets, stations.subset(chosen), seen[chosen], prediction, curve, len(of_use), settings, reference
    )


def _candidates(planned: PlannedNetwork, settings: PlanOptions) -> Stations:
    layout = planned.layout
    filling = filling_distance(planned.camera, planned.interior, layout.radius)
    distances = filling * np.array(_SHELLS)
    low = 0.0 if settings.nearest_mm is None else 1e-3 * settings.nearest_mm + layout.radius
    high = np.inf if settings.farthest_mm is None else max(1e-3 * settings.farthest_mm - layout.radius, low)
    distances = np.unique(np.clip(distances, low, high))
    bounds = tuple(np.radians(settings.elevation_deg))
    return shells(layout.middle, distances, settings.directions, (bounds[0], bounds[1]), np.radians([0.0, 90.0]))


def _restricted(planned: PlannedNetwork, some: Index) -> PlannedNetwork:
    """Return the network of some targets, for the search; it keeps the bars between them."""
    own = planned.layout
    place = np.full(len(own.points), -1)
    place[some] = np.arange(len(some))
    bars = planned.bars
    mask = (place[bars.first] >= 0) & (place[bars.second] >= 0)
    fewer = Bars(
        bars.bar[mask],
        place[bars.first[mask]],
        place[bars.second[mask]],
        bars.repeat_sigma_m[mask],
        bars.length_m,
        bars.sigma_m,
    )
    layout = PlannedObject(own.points[some], own.normals[some], own.diameters[some])
    return PlannedNetwork(planned.camera, planned.interior, planned.sigma_px, layout, fewer)


def _curve(
    planned: PlannedNetwork, stations: Stations, seen: Mask, order: Index
) -> tuple[tuple[int, float, float], ...]:
    """Return (number, worst, mean standard deviation in m) for growing numbers of stations. Starts at the first number
    that determines all targets that the full choice determines."""
    predictions = [(n, predict(planned, stations.subset(order[:n]), seen[order[:n]])) for n in range(2, len(order) + 1)]
    determined = [(n, predicted) for n, predicted in predictions if predicted is not None]
    most = max((len(predicted.points) for _, predicted in determined), default=0)
    return tuple(
        (n, float(np.nanmax(predicted.sigma)), float(np.sqrt(np.nanmean(predicted.sigma**2))))
        for n, predicted in determined
        if len(predicted.points) == most
    )


def _sufficient_stations(curve: tuple[tuple[int, float, float], ...], settings: PlanOptions, most: int) -> int:
    """Return the least number of stations that reaches the wanted precision; all if none does or none is wanted."""
    if settings.target_sigma_mm is None:
        return most
    return next((number for number, worst, _ in curve if 1e3 * worst <= settings.target_sigma_mm), most)


def _with_the_better_worst(
    planned: PlannedNetwork, stations: Stations, seen: Mask, choices: tuple[Index, ...]
) -> Index:
    """Return the choice with the best worst target; exchanges look at the mean of all."""

    def worst(chosen: Index) -> float:
        prediction = predict(planned, stations.subset(chosen), seen[chosen])
        return np.inf if prediction is None or np.isnan(prediction.sigma).any() else float(prediction.sigma.max())

    return min(reversed(choices), key=worst)


def _in_order_round(stations: Stations, chosen: Index, middle: Array) -> Index:
    """Return stations in the order of a walk around the object, with both rolls of one place together."""
    away = stations.centre[chosen] - middle
    around = np.round(np.arctan2(away[:, 1], away[:, 0]), 6)
    return chosen[np.lexsort((stations.roll_rad[chosen], away[:, 2], around))]


def spread_points(points: Array, most: int = _MOST_POINTS) -> Index:
    """Return some of the points (P, 3), each as far as possible from those before it; all if there are no more."""
    if len(points) <= most:
        return np.arange(len(points))
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    nearest = np.full(len(points), np.inf)
    while len(chosen) < most:
        nearest = np.minimum(nearest, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(nearest)))
    return np.sort(chosen)


@dataclass(frozen=True)
class StationCandidates:
    """Candidates of a selection: information (K, n, n) of each station on points (P, 3) and camera, prior information
    (n, n), and whether anything gives the scale."""

    information: Array
    prior: Array
    points: Array
    has_scale: bool

    @property
    def movements(self) -> Array:
        """Return orthonormal movements (3 P, 6 or 7) of all points together, which photographs do not determine."""
        columns = movements(self.points - self.points.mean(axis=0))[..., : 6 if self.has_scale else 7]
        return np.linalg.qr(columns.reshape(self.points.size, -1))[0]


def one_by_one(candidates: StationCandidates, count: int, progress: Progress) -> Index:
    """Return ``count`` stations, each with the least mean variance of the points in the free datum when added."""
    information, remove = candidates.information, candidates.movements
    total, chosen = candidates.prior.copy(), list[int]()
    while len(chosen) < min(count, len(information)):
        progress(len(chosen), count)
        best = int(np.argmin(_costs(total, information, remove, set(chosen))))
        chosen.append(best)
        total = total + information[best]
    return np.array(chosen, dtype=np.int64)


def exchanged(candidates: StationCandidates, chosen: Index, progress: Progress) -> Index:
    """Return the stations after replacing each in turn, once, by the one that helps most, if it saves enough."""
    information, remove, chosen = candidates.information, candidates.movements, chosen.copy()
    total = candidates.prior + information[chosen].sum(axis=0)
    cost = float(_costs(total, np.zeros((1, *total.shape)), remove, set())[0])
    for place in range(len(chosen)):
        progress(place, len(chosen))
        without = total - information[chosen[place]]
        others = set(np.delete(chosen, place).tolist())
        costs = _costs(without, information, remove, others)
        best = int(np.argmin(costs))
        if costs[best] < (1.0 - _LEAST_SAVING) * cost:
            chosen[place], cost = best, float(costs[best])
            total = without + information[best]
    return chosen


def _costs(total: Array, information: Array, remove: Array, chosen: set[int]) -> Array:
    """Return the mean variance of the points (K,) with each station added; infinite for stations already chosen."""
    size = len(remove)
    costs = np.full(len(information), np.inf)
    free = np.array([place for place in range(len(information)) if place not in chosen])
    for first in range(0, len(free), _AT_ONCE):
        some = free[first : first + _AT_ONCE]
        covariance = np.linalg.inv(total + information[some])[:, :size, :size]
        moved = np.sum(remove * (covariance @ remove), axis=(1, 2))
        costs[some] = (np.trace(covariance, axis1=1, axis2=2) - moved) / size
    return costs
