"""A plan of photographs as tables and sentences: stations, predicted uncertainty of targets, and its limits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.estimation.bundle.photograph_plan import PhotographPlan
from truing.estimation.bundle.planning import PredictedPrecision, body_motion, largest_sigma
from truing.report.numbers import count_text

_FEW_RAYS = 4  # a target with fewer of them shows no gross error
_NARROW = np.radians(60.0)


def stations_table(plan: PhotographPlan) -> pa.Table:
    """Return the stations: position, viewing direction, roll about it, number of visible targets."""
    stations, view = plan.stations, plan.stations.R[:, :, 2]
    distance = np.linalg.norm(stations.centre - plan.planned.layout.middle, axis=1)
    columns: dict[str, object] = {"station": np.arange(1, stations.count + 1)}
    columns |= {f"{axis}_mm": np.round(1e3 * stations.centre[:, i], 1) for i, axis in enumerate("xyz")}
    columns |= {f"view_{axis}": np.round(view[:, i], 6) for i, axis in enumerate("xyz")}
    columns |= {
        "roll_deg": np.round(np.degrees(stations.roll_rad), 1),
        "distance_mm": np.round(1e3 * distance, 1),
        "targets": plan.is_observed.sum(axis=1),
    }
    return pa.table(columns)


def targets_table(plan: PhotographPlan) -> pa.Table:
    """Return per target the number of rays, predicted standard deviations and their main limit."""
    prediction = plan.prediction
    sigmas = 1e3 * np.sqrt(np.diagonal(prediction.covariance, axis1=1, axis2=2))
    columns: dict[str, object] = {
        "body": list(plan.targets.body),
        "target": list(plan.targets.name),
        "rays": prediction.rays,
        "angle_deg": np.round(np.degrees(prediction.angle), 1),
    }
    columns |= {f"sigma_{axis}_mm": sigmas[:, i] for i, axis in enumerate("xyz")}
    columns |= {"sigma_mm": 1e3 * prediction.sigma, "limited_by": limits_of(prediction)}
    return pa.table(columns)


def limits_of(prediction: PredictedPrecision) -> list[str]:
    """Return the dominant contribution to each target's standard deviation: too few or narrow rays, camera, scale,
    noise."""
    squared = prediction.sigma**2
    camera = 1.0 - largest_sigma(prediction.with_known_camera) ** 2 / squared
    scale = 1.0 - largest_sigma(prediction.with_known_scale) ** 2 / squared
    texts = []
    for index, variance in enumerate(squared):
        if np.isnan(variance):
            texts.append("not seen twice")
        elif scale[index] > 0.5:
            texts.append("scale")
        elif camera[index] > 0.5:
            texts.append("camera")
        elif prediction.rays[index] < _FEW_RAYS:
            texts.append("few rays")
        else:
            texts.append("narrow rays" if prediction.angle[index] < _NARROW else "noise")
    return texts


def bodies_table(plan: PhotographPlan) -> pa.Table:
    """Return per body its targets' standard deviations and that of its pose, relative to the reference body."""
    prediction, body = plan.prediction, np.array(plan.targets.body)
    of_points = body[prediction.points]
    at = plan.planned.layout.points[prediction.points]
    rows = []
    for name in dict.fromkeys(plan.targets.body):
        sigma = prediction.sigma[body == name]
        members = np.flatnonzero(of_points == name)
        points_of_reference = None if plan.reference in (None, name) else np.flatnonzero(of_points == plan.reference)
        row: TableRow = {
            "body": name,
            "targets": int((body == name).sum()),
            "worst_mm": 1e3 * float(np.nanmax(sigma)) if np.isfinite(sigma).any() else None,
            "mean_mm": 1e3 * float(np.sqrt(np.nanmean(sigma**2))) if np.isfinite(sigma).any() else None,
        }
        if len(members) >= 3 and (points_of_reference is None or len(points_of_reference) >= 3):
            motion = np.sqrt(
                np.diag(body_motion(prediction.together, at, members, points_of_reference, at[members].mean(axis=0)))
            )
            row |= {"position_mm": 1e3 * float(motion[:3].max()), "rotation_urad": 1e6 * float(motion[3:].max())}
        rows.append(row)
    names = ("body", "targets", "worst_mm", "mean_mm", "position_mm", "rotation_urad")
    return pa.table({name: [row.get(name) for row in rows] for name in names})


def curve_table(plan: PhotographPlan) -> pa.Table:
    """Return the worst and the mean predicted standard deviation of targets by number of stations."""
    number, worst, mean = zip(*plan.curve, strict=True) if plan.curve else ((), (), ())
    return pa.table(
        {"stations": list(number), "worst_mm": [1e3 * v for v in worst], "mean_mm": [1e3 * v for v in mean]}
    )


def sentences(plan: PhotographPlan) -> list[str]:
    """Return the plan in sentences for the person who takes the photographs."""
    prediction, options = plan.prediction, plan.options
    texts = [
        f"{count_text(plan.stations.count, 'photograph')}, chosen from "
        f"{count_text(plan.candidates, 'station')}: the worst target to "
        f"{plan.worst_mm:.2g} mm, in the mean {1e3 * np.sqrt(np.nanmean(prediction.sigma**2)):.2g} mm "
        "(standard deviations)."
    ]
    if options.target_sigma_mm is not None:
        reached = (
            f"That is within the wanted {options.target_sigma_mm:g} mm"
            if plan.reaches
            else f"The wanted {options.target_sigma_mm:g} mm are not reached"
        )
        texts.append(f"{reached}{_remedy(plan)}.")
    if plan.undetermined:
        texts.append(f"Seen by fewer than two of them: {', '.join(plan.undetermined[:10])}.")
    known = float(np.nanmax(largest_sigma(prediction.with_known_camera)))
    if 1e3 * known < 0.8 * plan.worst_mm:
        texts.append(f"With a camera that is calibrated beforehand it would be {1e3 * known:.2g} mm.")
    if not len(plan.planned.bars.bar):
        texts.append("Nothing gives the scale, so this holds for the shape alone. Name scale_bars with their sigma.")
    return texts


def _remedy(plan: PhotographPlan) -> str:
    """Return a measure that would reach the wanted precision; empty if it is reached."""
    wanted = plan.options.target_sigma_mm
    if plan.reaches or wanted is None or plan.undetermined:
        return ""
    scaled = 1e3 * float(np.nanmax(largest_sigma(plan.prediction.with_known_scale)))
    other_variance = max(plan.worst_mm**2 - scaled**2, 0.0)
    if other_variance >= wanted**2:
        return f": the scale bars alone leave {np.sqrt(other_variance):.2g} mm for any photographs"
    more = int(np.ceil(plan.stations.count * scaled**2 / (wanted**2 - other_variance)))
    return f": about {count_text(more, 'photograph')} would, or a better camera"


def tables(plan: PhotographPlan) -> Mapping[str, pa.Table]:
    """Return all tables of the plan by the ending of their file name."""
    return {
        "": stations_table(plan),
        "-targets": targets_table(plan),
        "-bodies": bodies_table(plan),
        "-curve": curve_table(plan),
    }
