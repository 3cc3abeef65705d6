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
    is_observed: Mask
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
        unseen = np.flatnonzero(np.isnan(self.prediction.sigma))
        return tuple(f"{self.targets.body[i]}/{self.targets.name[i]}" for i in unseen)

    @property
    def reaches(self) -> bool:
        """True if every target reaches the wanted precision."""
        required_mm = self.options.target_sigma_mm
        return not self.undetermined and (required_mm is None or self.worst_mm <= required_mm)


def plan_photographs(
    planned: PlannedNetwork, targets: PlannedTargets, settings: PlanOptions, reference: str | None, progress: Progress
) -> PhotographPlan:
    """Return the plan; raises ValueError if no station sees enough targets, or if the stations form no network."""
    stations = _candidates(planned, settings)
    nearest = 0.0 if settings.nearest_mm is None else 1e-3 * settings.nearest_mm
    farthest = np.inf if settings.farthest_mm is None else 1e-3 * settings.farthest_mm
    limits = CameraLimits(nearest, farthest, np.radians(settings.incidence_deg), settings.least_px)
    visibility = visible(planned.camera, planned.interior, stations, planned.layout, limits)
    useful = useful_stations(visibility)
    if len(useful) < 2:
        raise ValueError(
            f"found {len(useful)} of {stations.count:,} stations with four visible targets, expected 2 or more"
        )
    stations, visibility = stations.subset(useful), visibility[useful]
    search_targets = spread_points(planned.layout.points)
    search_network = _restricted(planned, search_targets)
    candidates = StationCandidates(
        station_information(search_network, stations, visibility[:, search_targets]),
        weak_prior(search_network),
        search_network.layout.points,
        len(search_network.bars.bar) > 0,
    )
    order = one_by_one(candidates, settings.stations, progress)
    curve = _curve(planned, stations, visibility, order)
    greedy_choice = order[: _sufficient_stations(curve, settings, len(order))]
    chosen = _with_the_better_worst(
        planned, stations, visibility, (greedy_choice, exchanged(candidates, greedy_choice, progress))
    )
    chosen = _in_order_round(stations, chosen, planned.layout.middle)
    prediction = predict(planned, stations.subset(chosen), visibility[chosen])
    if prediction is None:
        stations_text = "1 station" if len(chosen) == 1 else f"{len(chosen):,} stations"
        raise ValueError(f"{stations_text} determine no network, expected more stations or more common targets")
    return PhotographPlan(
        planned,
        targets,
        stations.subset(chosen),
        visibility[chosen],
        prediction,
        curve,
        len(useful),
        settings,
        reference,
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


def _restricted(planned: PlannedNetwork, chosen: Index) -> PlannedNetwork:
    """Return the network of some targets, for the search; it keeps the bars between them."""
    layout_of_all = planned.layout
    new_index = np.full(len(layout_of_all.points), -1)
    new_index[chosen] = np.arange(len(chosen))
    bars = planned.bars
    mask = (new_index[bars.first] >= 0) & (new_index[bars.second] >= 0)
    kept_bars = Bars(
        bars.bar[mask],
        new_index[bars.first[mask]],
        new_index[bars.second[mask]],
        bars.repeat_sigma_m[mask],
        bars.length_m,
        bars.sigma_m,
    )
    layout = PlannedObject(layout_of_all.points[chosen], layout_of_all.normals[chosen], layout_of_all.diameters[chosen])
    return PlannedNetwork(planned.camera, planned.interior, planned.sigma_px, layout, kept_bars)


def _curve(
    planned: PlannedNetwork, stations: Stations, visibility: Mask, order: Index
) -> tuple[tuple[int, float, float], ...]:
    """Return (number, worst, mean standard deviation in m) for growing numbers of stations. Starts at the first number
    that determines all targets that the full choice determines."""
    predictions = [
        (n, predict(planned, stations.subset(order[:n]), visibility[order[:n]])) for n in range(2, len(order) + 1)
    ]
    determined = [(n, predicted) for n, predicted in predictions if predicted is not None]
    max_points = max((len(predicted.points) for _, predicted in determined), default=0)
    return tuple(
        (n, float(np.nanmax(predicted.sigma)), float(np.sqrt(np.nanmean(predicted.sigma**2))))
        for n, predicted in determined
        if len(predicted.points) == max_points
    )


def _sufficient_stations(curve: tuple[tuple[int, float, float], ...], settings: PlanOptions, most: int) -> int:
    """Return the least number of stations that reaches the wanted precision; all if none does or none is wanted."""
    if settings.target_sigma_mm is None:
        return most
    return next((number for number, worst, _ in curve if 1e3 * worst <= settings.target_sigma_mm), most)


def _with_the_better_worst(
    planned: PlannedNetwork, stations: Stations, visibility: Mask, choices: tuple[Index, ...]
) -> Index:
    """Return the choice with the best worst target; exchanges look at the mean of all."""

    def worst(chosen: Index) -> float:
        prediction = predict(planned, stations.subset(chosen), visibility[chosen])
        return np.inf if prediction is None or np.isnan(prediction.sigma).any() else float(prediction.sigma.max())

    return min(reversed(choices), key=worst)


def _in_order_round(stations: Stations, chosen: Index, middle: Array) -> Index:
    """Return stations in the order of a walk around the object, with both rolls of one place together."""
    outward = stations.centre[chosen] - middle
    azimuth = np.round(np.arctan2(outward[:, 1], outward[:, 0]), 6)
    return chosen[np.lexsort((stations.roll_rad[chosen], outward[:, 2], azimuth))]


def spread_points(points: Array, most: int = _MOST_POINTS) -> Index:
    """Return some of the points (P, 3), each as far as possible from those before it; all if there are no more."""
    if len(points) <= most:
        return np.arange(len(points))
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.full(len(points), np.inf)
    while len(chosen) < most:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
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
    information, free_movements = candidates.information, candidates.movements
    total, chosen = candidates.prior.copy(), list[int]()
    while len(chosen) < min(count, len(information)):
        progress(len(chosen), count)
        best = int(np.argmin(_costs(total, information, free_movements, set(chosen))))
        chosen.append(best)
        total = total + information[best]
    return np.array(chosen, dtype=np.int64)


def exchanged(candidates: StationCandidates, chosen: Index, progress: Progress) -> Index:
    """Return the stations after replacing each in turn, once, by the one that helps most, if it saves enough."""
    information, free_movements, chosen = candidates.information, candidates.movements, chosen.copy()
    total = candidates.prior + information[chosen].sum(axis=0)
    cost = float(_costs(total, np.zeros((1, *total.shape)), free_movements, set())[0])
    for position in range(len(chosen)):
        progress(position, len(chosen))
        reduced_total = total - information[chosen[position]]
        kept = set(np.delete(chosen, position).tolist())
        costs = _costs(reduced_total, information, free_movements, kept)
        best = int(np.argmin(costs))
        if costs[best] < (1.0 - _LEAST_SAVING) * cost:
            chosen[position], cost = best, float(costs[best])
            total = reduced_total + information[best]
    return chosen


def _costs(total: Array, information: Array, free_movements: Array, chosen: set[int]) -> Array:
    """Return the mean variance of the points (K,) with each station added; infinite for stations already chosen."""
    size = len(free_movements)
    costs = np.full(len(information), np.inf)
    unchosen = np.array([station for station in range(len(information)) if station not in chosen])
    for start in range(0, len(unchosen), _AT_ONCE):
        batch = unchosen[start : start + _AT_ONCE]
        covariance = np.linalg.inv(total + information[batch])[:, :size, :size]
        movement_trace = np.sum(free_movements * (covariance @ free_movements), axis=(1, 2))
        costs[batch] = (np.trace(covariance, axis1=1, axis2=2) - movement_trace) / size
    return costs
