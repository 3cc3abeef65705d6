"""Every artifact of a run: its file, its columns, its key; and the enforcement of both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from schemas.columns import COLUMNS, Column, find_column
from schemas.faults import Fault

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Artifact:
    """A file that a stage leaves: columns in order, which may be absent, whether covariates may be added.

    ``columns`` is empty for what is no table (report.html, model.toml). ``covariates`` allows further real columns
    under any name, as a campaign's own drives and surroundings have. ``families`` are numbered columns.
    """

    name: str
    file: str
    meaning: str
    columns: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    covariates: bool = False
    key: tuple[str, ...] = ()
    version: int = 1

    @cached_property
    def is_table(self) -> bool:
        """Whether the artifact is Parquet."""
        return bool(self.columns)

    def column(self, name: str) -> Column | None:
        """The definition of one of the artifact's columns, or None where it has no such column."""
        if name in self.columns or name in self.optional:
            return COLUMNS[name]
        found = find_column(name)
        if found is not None and found.family and found.name in self.families:
            return found
        if self.covariates and found is None:
            return Column(name, "real", "covariate, carried along", nullable=True)
        return None

    def units(self, names: list[str]) -> dict[str, str]:
        """Units of the named columns, for the file's metadata."""
        return {name: column.unit for name in names if (column := self.column(name)) is not None and column.unit}

    def arrow_schema(self, identifier: str = "int64", present: tuple[str, ...] = ()) -> pa.Schema:
        """The Arrow schema with the optional columns and family members named in ``present``."""
        import pyarrow as pa

        names = [*self.columns, *(name for name in present if name not in self.columns)]
        fields = []
        for name in names:
            column = self.column(name)
            if column is None:
                raise KeyError(f"{self.file} has no column {name}")
            fields.append(pa.field(name, arrow_type(column, identifier), nullable=column.nullable))
        return pa.schema(fields)

    def empty(self, identifier: str = "int64") -> pa.Table:
        """A table without rows, as a stage leaves it when it was not evaluated."""
        return self.arrow_schema(identifier).empty_table()

    def faults(self, table: pa.Table | pa.RecordBatch) -> list[Fault]:
        """Everything in which a table departs from this artifact: columns, types, nulls, bounds, choices."""
        names = table.schema.names
        missing = [Fault(self.file, f"a column {name}") for name in self.columns if name not in names]
        return missing + [fault for name in names for fault in self._column_faults(name, table.column(name))]

    def _column_faults(self, name: str, values: pa.ChunkedArray | pa.Array) -> Iterator[Fault]:
        column = self.column(name)
        if column is None:
            yield Fault(self.file, "no such column", column=name)
        elif not _type_fits(column, values.type):
            yield Fault(self.file, f"values of kind {column.kind}", column=name, value=str(values.type))
        else:
            yield from _value_faults(self.file, column, name, values)


def arrow_type(column: Column, identifier: str = "int64") -> pa.DataType:
    """The Arrow type that a column is stored in."""
    import pyarrow as pa

    if column.kind == "identifier":
        return pa.int64() if identifier == "int64" else pa.string()
    return {"text": pa.string(), "integer": pa.int64(), "real": pa.float64(), "flag": pa.bool_()}[column.kind]


def _type_fits(column: Column, found: pa.DataType) -> bool:
    import pyarrow as pa

    if pa.types.is_dictionary(found):
        found = found.value_type
    text = pa.types.is_string(found) or pa.types.is_large_string(found)
    return {
        "identifier": text or pa.types.is_int64(found),
        "text": text,
        "integer": pa.types.is_int64(found),
        "real": pa.types.is_float64(found),
        "flag": pa.types.is_boolean(found),
    }[column.kind]


def _value_faults(file: str, column: Column, name: str, values: pa.ChunkedArray | pa.Array) -> Iterator[Fault]:
    import pyarrow.compute as pc

    if values.null_count and not column.nullable:
        yield Fault(file, "a value in every row", column=name, value="empty", more=values.null_count - 1)
    if column.kind in ("real", "integer"):
        yield from _bound_faults(file, column, name, values)
    if column.choices:
        known = pc.fill_null(pc.is_in(values.cast("string"), value_set=_choices(column)), False)
        wrong = pc.filter(values, pc.and_(pc.invert(known), pc.is_valid(values)))
        if len(wrong):
            yield Fault(
                file, f"one of {', '.join(column.choices)}", column=name, value=str(wrong[0]), more=len(wrong) - 1
            )


def _choices(column: Column) -> pa.Array:
    import pyarrow as pa

    return pa.array(column.choices, pa.string())


def _bound_faults(file: str, column: Column, name: str, values: pa.ChunkedArray | pa.Array) -> Iterator[Fault]:
    import pyarrow.compute as pc

    if column.kind == "real":
        infinite = pc.filter(values, pc.invert(pc.fill_null(pc.is_finite(values), True)))
        if len(infinite):
            yield Fault(file, "finite numbers", column=name, value=str(infinite[0]), more=len(infinite) - 1)
    for bound, outside, word in ((column.minimum, pc.less, "at least"), (column.maximum, pc.greater, "at most")):
        if bound is None:
            continue
        wrong = pc.filter(values, pc.fill_null(outside(values, bound), False))
        if len(wrong):
            yield Fault(file, f"{word} {bound:g}", column=name, value=str(wrong[0]), more=len(wrong) - 1)


_POINT = ("x_mm", "y_mm", "z_mm")
_SIGMA = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
_CORRELATION = ("corr_xy", "corr_xz", "corr_yz")
_PLACE = ("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad")
_COVARIANCE = tuple(f"cov_{i}_{j}" for i in range(6) for j in range(i, 6))
_ABSORPTION = ("effect", "model", "deformation", "estimator", "leg", "parameter")
_CALIBRATION = ("model", "deformation", "leg", "parameter", "unit", "nominal", "identified", "sigma", "tolerance")
_ACCURACY = ("model", "deformation", "pose", "role", "position_error_um", "orientation_error_arcsec")
_ACCURACY_PARTS = ("dx_um", "dy_um", "dz_um", "rx_arcsec", "ry_arcsec", "rz_arcsec")
_ACCURACY_NOISE = ("position_noise_um", "orientation_noise_arcsec")
_WRENCH = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")

ARTIFACTS: dict[str, Artifact] = {
    artifact.name: artifact
    for artifact in (
        Artifact(
            "observations",
            "observations.parquet",
            "normalised object points, one row per pose, body and target",
            ("pose", "body", "target", *_POINT, *_SIGMA),
            optional=_CORRELATION,
            key=("pose", "body", "target"),
        ),
        Artifact(
            "survey",
            "survey.parquet",
            "the reference survey of the targets, in each body's own frame",
            ("body", "target", *_POINT, *_SIGMA, "leg"),
            optional=_CORRELATION,
            key=("body", "target"),
        ),
        Artifact(
            "scans",
            "scans.parquet",
            "where a dense scan of a body's surface lays the body, in the frame of the measurement",
            (
                "pose",
                "body",
                *_PLACE,
                *_COVARIANCE,
                "rms_mm",
                "n_used",
                "n_rejected",
                "overlap",
                "noise_ratio",
                "status",
                "message",
            ),
            key=("pose", "body"),
        ),
        Artifact(
            "configurations",
            "configurations.parquet",
            "one row per pose: role, time, actuator readings, covariates",
            ("pose", "role", "time_s"),
            optional=("temperature_c",),
            families=("rho",),
            covariates=True,
            key=("pose",),
        ),
        Artifact(
            "displacement",
            "displacement.parquet",
            "six-component displacement against six-component load",
            ("run", "step", "time_s", *_WRENCH, "dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"),
            optional=("role",),
            covariates=True,
            key=("run", "step"),
        ),
        Artifact(
            "exclusions",
            "exclusions.parquet",
            "raw rows that were read and left out, counted, with the reason",
            ("stage", "subject", "reason", "rows", "by"),
        ),
        Artifact(
            "qa",
            "qa.parquet",
            "one row per check",
            ("check", "subject", "value", "limit", "unit", "verdict", "message"),
            optional=("accepted",),
        ),
        Artifact(
            "poses",
            "poses.parquet",
            "rigid-body poses by every estimator, with covariance",
            (
                "pose",
                "body",
                "parent",
                "method",
                "default",
                "px_mm",
                "py_mm",
                "pz_mm",
                "rx_rad",
                "ry_rad",
                "rz_rad",
                *_COVARIANCE,
                "rms_mm",
                "n_used",
                "n_rejected",
                "status",
            ),
            key=("pose", "body", "parent", "method"),
        ),
        Artifact(
            "residuals",
            "residuals.parquet",
            "measured minus fitted, in the body frame, by the default estimator",
            ("pose", "body", "target", "dx_mm", "dy_mm", "dz_mm", "weight", "rejected", "reason"),
            key=("pose", "body", "target"),
        ),
        Artifact(
            "deformation",
            "deformation.parquet",
            "shift of each attachment along z of the platform",
            ("pose", "leg", "delta_rho_mm", "delta_bz_um", "sigma_um"),
            optional=("own_sigma_um", "p_value", "significant", "rejected", "reason"),
            key=("pose", "leg"),
        ),
        Artifact(
            "target_deformation",
            "target_deformation.parquet",
            "shift of each target in its body frame, where no mechanism says what drives it",
            ("pose", "body", "target", "axis", "displacement_um", "sigma_um"),
            key=("pose", "body", "target", "axis"),
        ),
        Artifact(
            "deformation_models",
            "deformation_models.parquet",
            "coefficients of the deformation models",
            ("model", "leg", "column", "coefficient", "sigma"),
            optional=("unit", "body", "target", "axis", "drive", "p_value", "significant"),
        ),
        Artifact(
            "deformation_errors",
            "deformation_errors.parquet",
            "error figures of each deformation model",
            ("model", "leg", "figure", "value", "unit"),
            optional=("subject",),
        ),
        Artifact(
            "compliance",
            "compliance.parquet",
            "displacement per load, entry by entry",
            ("model", "response", "load", "coefficient", "sigma", "unit"),
            optional=("p_value", "significant"),
            key=("model", "response", "load"),
        ),
        Artifact(
            "calibration",
            "calibration.parquet",
            "identified parameters of every model, by errors-in-variables maximum likelihood with tolerances as prior",
            (*_CALIBRATION, "pull", "identifiable", "status"),
            key=("model", "deformation", "leg", "parameter"),
        ),
        Artifact(
            "implicit_calibration",
            "implicit_calibration.parquet",
            "the same by least squares on the closure alone, as the telescope report does (eq. 30-33)",
            (*_CALIBRATION, "pull", "identifiable", "status"),
            key=("model", "deformation", "leg", "parameter"),
        ),
        Artifact(
            "correlations",
            "correlations.parquet",
            "correlated pairs of identified parameters in calibration.parquet, |correlation| of 0.05 and more",
            ("model", "deformation", "leg", "parameter", "other_leg", "other_parameter", "correlation"),
        ),
        Artifact(
            "accuracy",
            "accuracy.parquet",
            "measured minus predicted pose for every model of calibration.parquet",
            _ACCURACY,
            optional=(*_ACCURACY_PARTS, *_ACCURACY_NOISE),
            key=("model", "deformation", "pose"),
        ),
        Artifact(
            "implicit_accuracy",
            "implicit_accuracy.parquet",
            "the same for every model of implicit_calibration.parquet",
            _ACCURACY,
            optional=(*_ACCURACY_PARTS, *_ACCURACY_NOISE),
            key=("model", "deformation", "pose"),
        ),
        Artifact(
            "model_choice",
            "model_choice.parquet",
            "figures of every calibration, by which one is chosen",
            ("model", "deformation", "estimator", "figure", "value", "unit"),
            key=("model", "deformation", "estimator", "figure"),
        ),
        Artifact(
            "observability",
            "observability.parquet",
            "what the data can know of the parameters: rank, indices, and what cannot be told apart",
            ("model", "deformation", "leg", "figure", "value", "unit", "combination"),
        ),
        Artifact(
            "absorption",
            "absorption.parquet",
            "which parameters swallow an effect that the model leaves out: predicted, and what the fit did",
            (*_ABSORPTION, "unit", "predicted", "observed", "sigma"),
            key=_ABSORPTION,
        ),
        Artifact(
            "requirements",
            "requirements.parquet",
            "the accuracy asked for against the accuracy reached",
            (
                "model",
                "deformation",
                "component",
                "requirement",
                "error",
                "lower",
                "upper",
                "unit",
                "verdict",
                "message",
            ),
            key=("model", "deformation", "component"),
        ),
        Artifact(
            "diagnosis",
            "diagnosis.parquet",
            "one row per candidate cause",
            (
                "rank",
                "cause",
                "verdict",
                "subject",
                "p_value",
                "probability",
                "parameters",
                "follows",
                "rms_before",
                "rms_after",
                "heldout_rms_before",
                "heldout_rms_after",
                "noise_floor",
                "unit",
                "explanation",
                "next_measurement",
            ),
            key=("rank",),
        ),
        Artifact("model", "model.toml", "the extended model: nominal, identified parameters, accepted effects"),
        Artifact("report", "report.html", "the page: what was measured, found and left out"),
    )
}
