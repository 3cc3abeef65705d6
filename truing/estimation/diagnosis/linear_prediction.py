"""What a candidate would do to predictions, to first order: without a fit of its own for each that is rejected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.fitted_model import Poses, Stand
from truing.estimation.diagnosis.point_fit import MeasuredPoints, whitened_columns
from truing.estimation.diagnosis.prediction_error import PredictionError
from truing.estimation.diagnosis.signatures import POINTS, Signature


def after_first_step(stand: Stand, cause: object, own: Signature, values: NDArray) -> PredictionError:
    """Return the error on calibration poses once a candidate's parameters (P,), in plausible scales, are taken in."""
    step = _shared_step(stand, own, values)
    return _moved(stand.error, stand.measured, cause, values, step)


def held_out_after_first_step(
    stand: Stand, cause: object, own: Signature, values: NDArray, held_out: Poses | None
) -> PredictionError | None:
    """Return the same on held-out poses, None where there are none."""
    if held_out is None or stand.held_out is None:
        return None
    return _moved(stand.held_out, held_out.measured, cause, values, _shared_step(stand, own, values))


def _shared_step(stand: Stand, own: Signature, values: NDArray) -> NDArray:
    """Return by how much the shared unknowns (G,) give way to a candidate, in prior sigmas."""
    return -stand.fit.whitened.from_basis(own.explained @ values)


def _moved(
    error: PredictionError, measured: MeasuredPoints, cause: object, values: NDArray, step: NDArray
) -> PredictionError:
    motion = _points_motion(error, cause) @ values
    columns = whitened_columns(measured, error.frames, motion[..., None])[..., 0]
    return error.less(columns + error.by_shared @ step)


def _points_motion(error: PredictionError, cause: object) -> NDArray:
    """Return how the points (B, K, d, P) follow a candidate's parameters, per plausible scale."""
    designs, poses, size = error.designer(cause), len(error.local), error.measured.size
    parts = [error.channels[name] @ design[:, None] for name, design in designs.items() if name != POINTS]
    if POINTS in designs:
        own = designs[POINTS]
        parts.append(np.broadcast_to(own, (poses, *own.shape[1:])).reshape(poses, -1, size, own.shape[-1]))
    return np.sum(parts, axis=0) if len(parts) > 1 else parts[0]
