"""What gives or checks the scale, held against each other on a network that the rays alone shape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.named_adjustment import AdjustedNetwork
from truing.estimation.bundle.network import State
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.schemas.photograph_artifacts import FROM_MARKER, FROM_SURVEY, LENGTH, LENGTH_SIGMA
from truing.stages.bundle_adjustment.survey_distances import SurveyedPoints

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Figure = tuple[str, str, float | None, str]

_FEWEST = 4  # points of a body: fewer tell no scale of it
_SPREAD = 0.05  # of the larger extent: points on a line tell none, either


def scale_sources(found: AdjustedNetwork, bars: pa.Table | None, survey: SurveyedPoints | None) -> list[Figure]:
    """Figures: the lengths of each bar, of the survey and of known points over those of the rays, in the middle of all
    poses, with sigma; what is common to all of them is no more than the rays' own scale."""
    state = found.snooped.by_rays.state
    ratios: dict[str, list[tuple[float, float]]] = {}
    for pose in range(len(found.named.poses)):
        numbers = np.flatnonzero(found.named.network.point_pose == pose)
        places = {str(found.named.points[n]): state.points[n] for n in numbers if np.isfinite(state.points[n, 0])}
        for name, ratio, sigma in (
            *_of_bars(places, bars),
            *_of_survey(places, survey),
            *_of_known(found, state, pose),
        ):
            ratios.setdefault(name, []).append((ratio, sigma))
    figures: list[Figure] = []
    for name, values in ratios.items() if len(ratios) > 1 else ():
        ratio, sigma = np.array(values).T
        spread = float(np.std(ratio) / np.sqrt(len(ratio))) if len(ratio) > 1 else 0.0
        figures.append((LENGTH, name, float(np.median(ratio)), "1"))
        figures.append((LENGTH_SIGMA, name, float(np.hypot(np.median(sigma), spread)), "1"))
    return figures


def _of_bars(places: dict[str, Array], bars: pa.Table | None) -> list[tuple[str, float, float]]:
    found = []
    for row in [] if bars is None else bars.to_pylist():
        if row["bar"].startswith((FROM_SURVEY, FROM_MARKER)) or not {row["first"], row["second"]} <= places.keys():
            continue
        length = 1e3 * float(np.linalg.norm(places[row["second"]] - places[row["first"]]))
        sigma = float(np.hypot(row["sigma_mm"], row["repeat_sigma_mm"] or 0.0)) / row["length_mm"]
        found.append((f"bar {row['bar']}", row["length_mm"] / length, sigma))
    return found


def _of_survey(places: dict[str, Array], survey: SurveyedPoints | None) -> list[tuple[str, float, float]]:
    """The survey of each body of which a pose shows enough targets: as rigid as bodies are."""
    if survey is None:
        return []
    found = []
    for body in dict.fromkeys(survey.bodies.tolist()):
        own = [k for k in np.flatnonzero(survey.bodies == body) if survey.names[k] in places]
        if len(own) >= _FEWEST:
            told = _ratio(np.array([places[survey.names[k]] for k in own]), survey.xyz_m[own])
            found += [(f"survey of {body}", *told)] if told else []
    return found


def _of_known(found: AdjustedNetwork, state: State, pose: int) -> list[tuple[str, float, float]]:
    """Known points that the rays do not contradict by their shape."""
    network = found.adjustment.network
    here = network.point_pose[network.known.point] == pose
    rows = np.flatnonzero(here & np.isfinite(state.points[network.known.point, 0]))
    if found.adjustment.datum != "known" or len(rows) < _FEWEST:
        return []
    told = _ratio(state.points[network.known.point[rows]], network.known.xyz_m[rows])
    return [("known points", *told)] if told else []


def _ratio(seen: Array, stated: Array) -> tuple[float, float] | None:
    """Stated lengths over those seen, with sigma by what is left; by least absolute distances, as some may be wrong."""
    extent = np.linalg.svd(stated - stated.mean(0), compute_uv=False)
    if extent[1] < _SPREAD * extent[0]:
        return None
    weight = np.ones(len(seen))
    for _ in range(20):
        fit = umeyama(seen[None], stated[None], weight[None], with_scale=True)
        off = np.linalg.norm(fit.scale[0] * seen @ fit.R[0].T + fit.t[0] - stated, axis=1)
        weight = 1.0 / np.maximum(off, 1e-9 + 1e-3 * np.median(off))
        weight /= weight.max()
    return float(fit.scale[0]), float(np.median(off) / (0.6745 * extent[0]))
