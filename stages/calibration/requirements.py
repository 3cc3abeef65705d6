"""The accuracy asked for against the accuracy reached: meets, fails, or undecided within what so few poses can say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.calibration.accuracy import PoseErrors
from stages.responses.tables import Rows

if TYPE_CHECKING:
    from schemas.sections import Requirement

_COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
_WITHIN = 1.959964  # of a normal error's 95 %, in standard deviations


def requirement_rows(
    asked: Requirement, key: tuple[str, str], errors: PoseErrors, measurement: NDArray, held_out: NDArray
) -> Rows:
    """Return a row per component that something is asked of, judged by the errors of a model (model, deformation).

    measurement (B, 6, 6): covariance of the measured poses, whose noise is not the machine's; held_out (B,): the poses
    judged by, and where there are none all of them. The error is what 95 of 100 poses stay below: 1.96 rms of measured
    minus predicted, less the measurement's share; the interval is that of the rms of so many normal errors.
    """
    rows, judged = Rows("requirements"), held_out if held_out.any() else ~held_out
    by = "" if held_out.any() else ", judged by the poses that were fitted"
    for i, name in enumerate(_COMPONENTS):
        unit = "mm" if i < 3 else "deg"
        limit = getattr(asked, f"{name}_{unit}")
        if limit is not None:
            si = 1e-3 if i < 3 else np.pi / 180
            found = _interval(errors.error[judged, i] / si, measurement[judged, i, i] / si**2)
            _add(rows, key, name, unit, limit, found, by)
    return rows


def _interval(errors: NDArray, variances: NDArray) -> tuple[float, float, float] | None:
    """Return the 95 % error with the ends of its interval; None without poses."""
    from scipy.special import chdtri

    told = np.isfinite(errors)
    count = int(told.sum())
    if not count:
        return None
    square = float(np.sum(errors[told] ** 2))
    # A measurement that is said to be noisier than what was seen of it tells less, not more.
    noise = min(float(np.mean(variances[told])), square / count)
    scales = (count, chdtri(count, 0.025), chdtri(count, 0.975))
    middle, low, high = (_WITHIN * float(np.sqrt(max(square / scale - noise, 0.0))) for scale in scales)
    return middle, low, high


def _add(
    rows: Rows,
    key: tuple[str, str],
    component: str,
    unit: str,
    limit: float,
    found: tuple[float, float, float] | None,
    by: str,
) -> None:
    error, lower, upper = found or (None, None, None)
    verdict = "not evaluated" if upper is None or lower is None else _verdict(lower, upper, limit)
    rows.add(
        model=key[0],
        deformation=key[1],
        component=component,
        requirement=limit,
        error=error,
        lower=lower,
        upper=upper,
        unit=unit,
        verdict=verdict,
        message=_message(component, verdict, limit, unit, found) + by,
    )


def _verdict(lower: float, upper: float, limit: float) -> str:
    if upper <= limit:
        return "meets"
    return "fails" if lower > limit else "undecided"


def _message(component: str, verdict: str, limit: float, unit: str, found: tuple[float, float, float] | None) -> str:
    if found is None:
        return f"{component}: no pose to judge by"
    error, lower, upper = found
    told = f"95 of 100 poses stay below {error:.2g} {unit} (between {lower:.2g} and {upper:.2g})"
    if error == 0:
        told = f"no error beyond the measurement's own noise (at most {upper:.2g} {unit})"
    return f"{component}: {told}, asked for {limit:g} {unit}: {verdict}"
