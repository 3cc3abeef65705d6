"""Tables of a diagnosis by epoch: errors of predictions, pulls, rejected values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, TableRow
from truing.inference.deviating_epochs import p_values
from truing.inference.prediction import fit_squares
from truing.inference.pulls import Pulls, pulls
from truing.inference.screening import least_gross
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.extended_model import IdentifiedGeometry, identified_geometry
from truing.simulation.mechanisms.model import MechanismModel
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.fitter import ScreenedValue
    from truing.inference.observations import Epochs
    from truing.inference.prediction import PredictionError
    from truing.inference.selection import CauseDiagnosis
    from truing.simulation.effects_model import EffectsModel
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

_ISOLATED = "gross error: far from where the target is in the poses before and after it"
_GROSS = "gross error: its residual is far outside those of its target"
_UM = 1e6
_OPTIONAL_ERRORS = ("rms_nominal", "sigma_of_fit", "p_deviates")

PullName = tuple[int | None, str]  # the leg, None for all, and the parameter


def errors_by_role(diagnosis: CauseDiagnosis) -> Iterator[tuple[str, PredictionError, PredictionError]]:
    """Yield the role of epochs, and their errors without and with the findings."""
    (error, held_out), final = diagnosis.errors_without_any, diagnosis.final
    yield "calibration", error, final.error
    if diagnosis.held_out is not None and held_out is not None and final.held_out is not None:
        yield HELD_OUT, held_out, final.held_out


def identified_table(artifact: str, rows: list[TableRow], key: str, present: Sequence[str] = ()) -> pa.Table:
    """Rows as an artifact's table, whose identifiers, in the column ``key``, are integers or text."""
    identifier = "int64" if all(isinstance(row[key], int) for row in rows) else "string"
    return pa.Table.from_pylist(rows, schema=ARTIFACTS[artifact].arrow_schema(identifier, present=tuple(present)))


def prediction_table(
    diagnosis: CauseDiagnosis,
    data: DiagnosisData[EffectsModel],
    part: Callable[[PredictionError], PredictionError] = lambda error: error,
    nominal: Mapping[str, PredictionError] = MappingProxyType({}),
) -> pa.Table:
    """Rows of prediction.parquet: every pose without and with the findings; ``part``: channels that count.

    ``nominal``: errors of the machine as its description has it, by role of the poses. Where poses were held out,
    ``sigma_of_fit`` is the error that the uncertainty of the fit alone causes there.
    """
    poses = {"calibration": data.calibration.conditions.poses}
    poses |= {} if data.held_out is None else {HELD_OUT: data.held_out.conditions.poses}
    rows: list[TableRow] = []
    for role, *errors in errors_by_role(diagnosis):
        before, after = map(part, errors)
        columns = {
            "rms_before": before.rms_by_epoch,
            "rms_after": after.rms_by_epoch,
            "largest_before": before.largest_by_epoch,
            "largest_after": after.largest_by_epoch,
            **({"rms_nominal": part(nominal[role]).rms_by_epoch} if role in nominal else {}),
            **_of_fit(diagnosis, after, role),
        }
        p_deviates = p_values(diagnosis.final) if role != HELD_OUT else np.full(len(poses[role]), np.nan)
        is_seen = np.any(after.is_observed, axis=1)  # not at a pose whose values are all left out as gross errors
        rows += [
            {
                "pose": pose,
                "role": role,
                "unit": "um",
                **{name: float(values[b]) * _UM if is_seen[b] else None for name, values in columns.items()},
                "p_deviates": None if np.isnan(p_deviates[b]) else float(p_deviates[b]),
            }
            for b, pose in enumerate(poses[role])
        ]
    return identified_table("prediction", rows, "pose", tuple(filter(rows[-1].__contains__, _OPTIONAL_ERRORS)))


def _of_fit(diagnosis: CauseDiagnosis, error: PredictionError, role: str) -> dict[str, Array]:
    """Errors (B,) that the uncertainty of the final fit causes at held-out poses, where they were computed."""
    squares = fit_squares(error, diagnosis.final.covariance()) if role == HELD_OUT else None
    return {} if squares is None else {"sigma_of_fit": np.sqrt(squares)}


def left_out_table(diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel]) -> pa.Table:
    """Rows of diagnosis_left_out.parquet: existing values that were rejected as gross errors."""
    rows: list[TableRow] = [
        {
            "pose": point.pose,
            "subject": point.subject,
            "reason": _ISOLATED,
            "value": 1e3 * point.distance,
            "limit": None,
            "unit": "mm",
            "measured_there": None,
        }
        for point in data.isolated
    ]
    rows += [
        {
            **_row_identifiers(value, data),
            "subject": _subject(value, diagnosis),
            "reason": _GROSS,
            "value": value.length,
            "limit": least_gross(diagnosis.final.measured.size),
            "unit": "sigma",
            "measured_there": int(_epochs_of(value, data).measured.is_observed[value.row].sum()),
        }
        for value in diagnosis.screened
    ]
    where = [name for name in ("pose", "run", "step") if name in rows[0]]
    return identified_table("diagnosis_left_out", rows, where[0], [*where, "measured_there"])


def _epochs_of(value: ScreenedValue, data: DiagnosisData[EffectsModel]) -> Epochs:
    return data.held_out if value.held_out and data.held_out is not None else data.calibration


def _row_identifiers(value: ScreenedValue, data: DiagnosisData[EffectsModel]) -> dict[str, object]:
    """The pose, or the run and step, by name."""
    conditions = _epochs_of(value, data).conditions
    if not hasattr(conditions, "run"):
        return {"pose": conditions.poses[value.row]}
    return {"run": plain_number(conditions.run[value.row]), "step": int(conditions.step[value.row])}


def plain_number(name: object) -> object:
    """A name out of an array as Python has it."""
    return name.item() if hasattr(name, "item") else name


def _subject(value: ScreenedValue, diagnosis: CauseDiagnosis) -> str:
    """Body and target, or the channel."""
    model = diagnosis.final.model
    name = model.channel_names[value.channel]
    return f"{model.channel_kinds[value.channel]} {name}" if len(model.channel_kinds) > value.channel else name


def pull_tables(before: FittedModel, after: FittedModel) -> dict[str, pa.Table]:
    """pulls.parquet and pull_sums.parquet; without rows if no tolerance is declared.

    Shifts are counted from nominal, also where the campaign starts from an earlier one: what that knew is data.
    """
    geometries = [_geometry(fitted_model) for fitted_model in (before, after)]
    known_parameters = zip(geometries[1].parameters, geometries[1].known, strict=True)
    names: list[PullName] = [(entry.leg + 1, entry.name) for entry, known in known_parameters if known]
    return _pull_tables(names, *map(_pulls_of_geometry, geometries), in_si=True)


def _geometry(fitted: FittedModel) -> IdentifiedGeometry:
    assert isinstance(fitted.model, MechanismModel)
    return identified_geometry(fitted.model, fitted.fit.shared, fitted.covariance())


def _pulls_of_geometry(geometry: IdentifiedGeometry) -> Pulls:
    known = np.flatnonzero(geometry.known)
    shift = (geometry.values - geometry.nominal)[known]
    return pulls(shift, geometry.prior[np.ix_(known, known)], geometry.covariance[np.ix_(known, known)])


def sensor_pull_tables(names: list[PullName], before: FittedModel, after: FittedModel) -> dict[str, pa.Table]:
    """The same of a sensor's geometry and stiffness, whose unknowns are these."""
    return _pull_tables(names, *map(_pulls_of_sensor, (before, after)), in_si=False)


def _pulls_of_sensor(fitted: FittedModel) -> Pulls:
    indices: NDArray[np.int64] = np.r_[fitted.model.layout["geometry"], fitted.model.layout["stiffness"]]
    return pulls(fitted.fit.shared[indices], np.eye(len(indices)), fitted.covariance()[np.ix_(indices, indices)])


def _pull_tables(names: list[PullName], before: Pulls, after: Pulls, *, in_si: bool) -> dict[str, pa.Table]:
    """Return the tables; ``in_si``: shifts are in m and 1, not in tolerances."""
    is_length = np.array([not name.startswith("u_") for _, name in names], bool)
    rows, sums = Rows("pulls"), Rows("pull_sums")
    if names:
        rows.add(
            leg=[leg for leg, _ in names],
            parameter=[name for _, name in names],
            pull_before=before.pull,
            pull_after=after.pull,
            identifiable=after.identifiable,
            offset_after=np.where(is_length, 1e3, 1.0) * after.offset if in_si else np.nan * after.offset,
            explained_after=after.explained,
            unit=["mm" if long and in_si else "1" for long in is_length],
        )
        for model, fitted in (("plain", before), ("extended", after)):
            band = {"lower": fitted.lower, "upper": fitted.upper, "p_value": fitted.p_value}
            sums.add(model=model, chi_square=fitted.chi_square, freedom=fitted.freedom, **band)
    return {"pulls": rows.table(), "pull_sums": sums.table()}
