"""Where to stand with a camera so that the targets of a campaign are known as well as is wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.estimation.bundle.network import Array, Bars, Index
from truing.estimation.bundle.planning.choice import Candidates, exchanged, one_by_one, spread_points
from truing.estimation.bundle.planning.information import PlannedNetwork, station_information, useful, weak_prior
from truing.estimation.bundle.planning.prediction import Prediction, predict
from truing.estimation.bundle.planning.stations import Layout, Limits, Mask, Stations, filling_distance, sees, shells
from truing.report.numbers import count as counted

Progress = Callable[[int, int], None]

_SHELLS = (1.05, 1.35, 1.75)  # of the distance from which the object fills the format


@dataclass(frozen=True)
class PlanWish:
    """What the caller asked for: at most so many stations; the standard deviation in mm to reach, none where as many
    are taken; distances, elevations, directions and rolls of the candidates; what a camera sees."""

    stations: int = 12
    wanted_mm: float | None = None
    nearest_mm: float | None = None
    farthest_mm: float | None = None
    elevation_deg: tuple[float, float] = (0.0, 80.0)
    directions: int = 60
    incidence_deg: float = 60.0
    least_px: float = 8.0


@dataclass(frozen=True)
class Targets:
    """The targets: body and name of each, where they are (P, 3) in m, normals (P, 3), diameters (P,) in m."""

    body: tuple[str, ...]
    name: tuple[str, ...]
    layout: Layout


@dataclass(frozen=True)
class PhotographPlan:
    """What was chosen: stations in the order in which to take them, what they see, what that predicts, and how well
    fewer or more of them would have done: (number, worst, mean standard deviation in m)."""

    planned: PlannedNetwork
    targets: Targets
    stations: Stations
    seen: Mask
    prediction: Prediction
    curve: tuple[tuple[int, float, float], ...]
    candidates: int
    wish: PlanWish
    reference: str | None

    @property
    def worst_mm(self) -> float:
        """The largest standard deviation of a target that is determined, mm."""
        return 1e3 * float(np.nanmax(self.prediction.sigma))

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Targets that no two stations see."""
        lost = np.flatnonzero(np.isnan(self.prediction.sigma))
        return tuple(f"{self.targets.body[i]}/{self.targets.name[i]}" for i in lost)

    @property
    def reaches(self) -> bool:
        """Whether every target is known as well as is wanted."""
        wanted = self.wish.wanted_mm
        return not self.undetermined and (wanted is None or self.worst_mm <= wanted)


def plan_photographs(
    planned: PlannedNetwork, targets: Targets, wish: PlanWish, reference: str | None, progress: Progress
) -> PhotographPlan:
    """Choose stations; raises ValueError where none sees enough, or where what they see makes no network."""
    stations = _candidates(planned, wish)
    limits = _limits(wish)
    seen = sees(planned.camera, planned.interior, stations, planned.layout, limits)
    of_use = useful(seen)
    if len(of_use) < 2:
        raise ValueError(
            f"found {len(of_use)} of {counted(stations.count, 'station')} with four targets in view, expected more"
        )
    stations, seen = stations.only(of_use), seen[of_use]
    some = spread_points(planned.layout.points)
    search = _restricted(planned, some)
    candidates = Candidates(
        station_information(search, stations, seen[:, some]),
        weak_prior(search),
        search.layout.points,
        len(search.bars.bar) > 0,
    )
    order = one_by_one(candidates, wish.stations, progress)
    curve = _curve(planned, stations, seen, order)
    first = order[: _enough(curve, wish, len(order))]
    chosen = _with_the_better_worst(planned, stations, seen, (first, exchanged(candidates, first, progress)))
    chosen = _in_order_round(stations, chosen, planned.layout.middle)
    prediction = predict(planned, stations.only(chosen), seen[chosen])
    if prediction is None:
        raise ValueError(
            f"no network is made by {counted(len(chosen), 'station')}, expected more of them, or more targets in common"
        )
    return PhotographPlan(
        planned, targets, stations.only(chosen), seen[chosen], prediction, curve, len(of_use), wish, reference
    )


def _candidates(planned: PlannedNetwork, wish: PlanWish) -> Stations:
    layout = planned.layout
    filling = filling_distance(planned.camera, planned.interior, layout.radius)
    distances = filling * np.array(_SHELLS)
    low = 0.0 if wish.nearest_mm is None else 1e-3 * wish.nearest_mm + layout.radius
    high = np.inf if wish.farthest_mm is None else max(1e-3 * wish.farthest_mm - layout.radius, low)
    distances = np.unique(np.clip(distances, low, high))
    bounds = tuple(np.radians(wish.elevation_deg))
    return shells(layout.middle, distances, wish.directions, (bounds[0], bounds[1]), np.radians([0.0, 90.0]))


def _limits(wish: PlanWish) -> Limits:
    nearest = 0.0 if wish.nearest_mm is None else 1e-3 * wish.nearest_mm
    farthest = np.inf if wish.farthest_mm is None else 1e-3 * wish.farthest_mm
    return Limits(nearest, farthest, np.radians(wish.incidence_deg), wish.least_px)


def _restricted(planned: PlannedNetwork, some: Index) -> PlannedNetwork:
    """The network of some targets, for the search; bars are those between them."""
    own = planned.layout
    place = np.full(len(own.points), -1)
    place[some] = np.arange(len(some))
    bars = planned.bars
    kept = (place[bars.first] >= 0) & (place[bars.second] >= 0)
    fewer = Bars(
        bars.bar[kept],
        place[bars.first[kept]],
        place[bars.second[kept]],
        bars.repeat_sigma_m[kept],
        bars.length_m,
        bars.sigma_m,
    )
    layout = Layout(own.points[some], own.normals[some], own.diameters[some])
    return PlannedNetwork(planned.camera, planned.interior, planned.sigma_px, layout, fewer)


def _curve(
    planned: PlannedNetwork, stations: Stations, seen: Mask, order: Index
) -> tuple[tuple[int, float, float], ...]:
    """The worst and the mean standard deviation, m, that so many stations reach; from the first number that
    determines all that the last one does."""
    found = [(n, predict(planned, stations.only(order[:n]), seen[order[:n]])) for n in range(2, len(order) + 1)]
    whole = [(n, one) for n, one in found if one is not None]
    most = max((len(one.points) for _, one in whole), default=0)
    return tuple(
        (n, float(np.nanmax(one.sigma)), float(np.sqrt(np.nanmean(one.sigma**2))))
        for n, one in whole
        if len(one.points) == most
    )


def _enough(curve: tuple[tuple[int, float, float], ...], wish: PlanWish, most: int) -> int:
    """The least number of stations that reaches what is wanted; all where none does, or nothing is."""
    if wish.wanted_mm is None:
        return most
    return next((number for number, worst, _ in curve if 1e3 * worst <= wish.wanted_mm), most)


def _with_the_better_worst(
    planned: PlannedNetwork, stations: Stations, seen: Mask, choices: tuple[Index, ...]
) -> Index:
    """Of several choices the one whose worst target is known best: exchanges look at the mean of all."""

    def worst(chosen: Index) -> float:
        found = predict(planned, stations.only(chosen), seen[chosen])
        return np.inf if found is None or np.isnan(found.sigma).any() else float(found.sigma.max())

    return min(reversed(choices), key=worst)


def _in_order_round(stations: Stations, chosen: Index, middle: Array) -> Index:
    """Stations in the order of a walk round the object, the two rolls of one place together."""
    away = stations.centre[chosen] - middle
    around = np.round(np.arctan2(away[:, 1], away[:, 0]), 6)
    return chosen[np.lexsort((stations.roll_rad[chosen], away[:, 2], around))]
