"""What is left of a measurement: what was read, checked, left out, and where the bodies lay."""

from __future__ import annotations

from truing.schemas.artifact import Artifact, parquet

_POINT = ("x_mm", "y_mm", "z_mm")
_SIGMA = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
_CORRELATION = ("corr_xy", "corr_xz", "corr_yz")
_PLACE = ("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad")
_COVARIANCE = tuple(f"cov_{i}_{j}" for i in range(6) for j in range(i, 6))
_WRENCH = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
_SURROUNDINGS = ("air_temperature_c", "air_pressure_hpa", "relative_humidity_pct", "material_temperature_c")

MEASUREMENT = (
    parquet(
        "observations",
        "normalised object points, one row per pose, body and target",
        ("pose", "body", "target", *_POINT, *_SIGMA),
        optional=(*_CORRELATION, "point"),
        key=("pose", "body", "target"),
    ),
    parquet(
        "survey",
        "the reference survey of the targets, in each body's own frame",
        ("body", "target", *_POINT, *_SIGMA, "leg"),
        optional=_CORRELATION,
        key=("body", "target"),
    ),
    parquet(
        "measured_poses",
        "poses as the instrument gave them, in the frame of the measurement, with their declared covariance",
        ("pose", "body", *_PLACE, *_COVARIANCE),
        key=("pose", "body"),
    ),
    parquet(
        "scans",
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
    parquet(
        "configurations",
        "one row per pose: role, time, actuator readings, covariates",
        ("pose", "role", "time_s"),
        optional=("temperature_c", "repeat_of", "event"),
        families=("rho",),
        covariates=True,
        key=("pose",),
    ),
    Artifact(
        "readings",
        "observations.parquet",
        "readings (um, arcsec) of an interferometer, compensated for air, one row per load step and channel",
        ("run", "step", "time_s", *_WRENCH, "channel", "reading", "unit", "sigma"),
        optional=("role", *_SURROUNDINGS),
        covariates=True,
        key=("run", "step", "channel"),
    ),
    parquet(
        "signals",
        "signals of a force sensor, one row per load step",
        ("run", "step", "time_s", *_WRENCH),
        optional=("role", *_SURROUNDINGS),
        families=("signal",),
        covariates=True,
        key=("run", "step"),
    ),
    parquet(
        "quadrature",
        "raw signals of an interferometer: the ellipse of every channel, and what it leaves",
        (
            "channel",
            "samples",
            *("x0", "y0", "amplitude_x", "amplitude_y", "lag_rad"),
            *("radius_before", "radius_after", "radius_uncut", "radius_mean", "cut_share"),
            *("periodic_error_um", "miscount_risk", "status"),
        ),
        optional=("sigma_source",),
        key=("channel",),
    ),
    parquet(
        "reading_corrections",
        "what was corrected in readings for air and material, and what the correction leaves uncertain, at most",
        ("subject", "correction", "largest", "sigma", "unit"),
        key=("subject", "correction"),
    ),
    parquet(
        "positions",
        "where an axis stood at its targets, one row per approach",
        ("run", "target_mm", "direction", "cycle", "position_mm"),
        optional=(*_SURROUNDINGS, "position_read_mm", "row_order"),
        key=("run", "target_mm", "direction", "cycle"),
    ),
    parquet(
        "given_compliance",
        "the simulated compliance that the campaign's compliance_file gives, SI",
        ("response", "load", "coefficient", "unit"),
        key=("response", "load"),
    ),
    parquet(
        "displacement",
        "displacement of the platform per load case, zeros and drift of the runs taken out; empty where never measured",
        (
            "case",
            "branch",
            *_WRENCH,
            "dx_mm",
            "dy_mm",
            "dz_mm",
            "rx_rad",
            "ry_rad",
            "rz_rad",
            *_COVARIANCE,
            "n_used",
            "n_rejected",
        ),
        optional=("role",),
        key=("case",),
        version=2,
    ),
    parquet(
        "reading_residuals",
        "readings less their run's own smooth curve of load and time, and what was kept out",
        ("run", "step", "channel", "branch", "residual", "sigma", "unit", "weight", "rejected", "reason"),
        optional=("decision", "geometry", "geometry_sigma"),
        key=("run", "step", "channel"),
    ),
    parquet(
        "run_terms",
        "zero and drift of every run and channel, as the displacement is counted from",
        ("run", "channel", "term", "value", "sigma", "unit", "p_value"),
        key=("run", "channel", "term"),
    ),
    parquet(
        "exclusions",
        "raw rows that were read and left out, counted, with the reason",
        ("stage", "subject", "reason", "rows", "by"),
    ),
    parquet(
        "exclusion_effects",
        "what each [[exclude]] left out, how much of it is a gross error all the same, and by how much poses or "
        "displacements would change at most if all were taken back",
        (
            *("entry", "subject", "by", "decided_on", "reason", "rows", "gross_anyway"),
            *("largest_change", "unit", "over_sigma"),
        ),
        key=("entry", "subject"),
    ),
    parquet(
        "relabelled",
        "targets that the files call otherwise in some poses, or that a later survey found elsewhere, and in how many "
        "points",
        ("body", "called", "target", "from_pose", "to_pose", "rows", "reason"),
    ),
    parquet(
        "likely_names",
        "names that no survey knows, at the place of a target that is not seen with them: a suggestion, never applied",
        ("body", "called", "target", "from_pose", "to_pose", "rows", "distance_mm"),
    ),
    parquet(
        "resurveys",
        "where a later survey has the targets, in the frame of the first, less where they were before",
        (
            *("later_survey", "body", "target", "shift_x_mm", "shift_y_mm", "shift_z_mm"),
            *(*_SIGMA, "p_value", "relocated", "holds_as", "from_pose", "status"),
        ),
        key=("later_survey", "body", "target"),
    ),
    parquet(
        "qa",
        "one row per check",
        ("check", "subject", "value", "limit", "unit", "verdict", "message"),
        optional=("accepted",),
    ),
    parquet(
        "belonging",
        "one row per tested relation between parts of the campaign, with the slips of the hand that explain the data",
        (
            *("relation", "subject", "state", "reason_code", "misfit", "misfit_explained", "limit", "unit"),
            *("slips", "rivals", "hidden_slips", "tried", "accepted"),
        ),
    ),
    parquet(
        "poses",
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
    parquet(
        "residuals",
        "measured minus fitted, in the body frame, by the default estimator",
        ("pose", "body", "target", "dx_mm", "dy_mm", "dz_mm", "weight", "rejected", "reason"),
        optional=("decision",),
        key=("pose", "body", "target"),
    ),
)
