"""Artifacts of the measured data: points, readings, loads, checks, poses and residuals."""

from __future__ import annotations

from truing.schemas.artifact import parquet
from truing.schemas.photograph_artifacts import CORRELATION, COVARIANCE, PLACE, POINT, SIGMA

WRENCH = "fx_n fy_n fz_n mx_nm my_nm mz_nm"
_SURROUNDINGS = "air_temperature_c air_pressure_hpa relative_humidity_pct material_temperature_c"

MEASUREMENT = (
    parquet(
        "observations",
        "object points as read, in uniform names and units, one row per pose, body and target",
        f"pose* body* target* {POINT} {SIGMA}",
        optional=f"{CORRELATION} point",
    ),
    parquet(
        "survey",
        "reference survey of the targets, in the frame of each body",
        f"body* target* {POINT} {SIGMA} leg",
        optional=CORRELATION,
    ),
    parquet(
        "measured_poses",
        "poses that the instrument reported, in its own frame, with their declared covariance",
        f"pose* body* {PLACE} {COVARIANCE}",
        optional="recorded_a_rad recorded_b_rad recorded_c_rad",
    ),
    parquet(
        "scans",
        "pose of each body from a dense scan of its surface, in the frame of the measurement",
        f"pose* body* {PLACE} {COVARIANCE} rms_mm n_used n_rejected overlap noise_ratio status message",
    ),
    parquet(
        "configurations",
        "one row per pose: role, time, actuator readings, covariates",
        "pose* role time_s",
        optional="temperature_c repeat_of event approach series",
        families="rho",
        covariates=True,
    ),
    parquet(
        "distances",
        "measured distances between targets of links, or from a target to a station",
        "pose* from_link from_end* to_link to_end* reading_mm sigma_mm",
    ),
    parquet(
        "joints",
        "joints of an open chain with the links that they move, as [mechanism] describes them",
        "node* joint link below joint_kind x_mm y_mm z_mm rx_rad ry_rad rz_rad axis_x axis_y axis_z follows_joint "
        "factor zero_si mass_kg com_x_mm com_y_mm com_z_mm lower_si upper_si input",
        optional="closure",
    ),
    parquet(
        "readings",
        "readings (um, arcsec) of an interferometer, compensated for air, one row per load step and channel",
        f"run* step* time_s {WRENCH} channel* reading unit sigma",
        optional=f"role {_SURROUNDINGS}",
        covariates=True,
        file="observations.parquet",
    ),
    parquet(
        "signals",
        "signals of a force sensor, one row per load step",
        f"run* step* time_s {WRENCH}",
        optional=f"role {_SURROUNDINGS}",
        families="signal",
        covariates=True,
    ),
    parquet(
        "loads_joined",
        "how the rows of [files.loads] were joined to those of signals",
        "joined_by signal_rows load_rows rows_matched",
        optional="largest_apart_s earlier_s later_s",
    ),
    parquet(
        "quadrature",
        "raw interferometer signals: fitted ellipse of each channel, and scatter about it",
        "channel* samples x0 y0 amplitude_x amplitude_y lag_rad radius_before radius_after radius_uncut radius_mean "
        "cut_share periodic_error_um miscount_risk status",
        optional="sigma_source",
    ),
    parquet(
        "reading_corrections",
        "largest correction of readings for air and material, and its uncertainty",
        "subject* correction* largest sigma unit",
    ),
    parquet(
        "positions",
        "measured positions of an axis at its targets, one row per approach",
        "run* target_mm* direction* cycle* position_mm",
        optional=f"{_SURROUNDINGS} position_read_mm row_order",
    ),
    parquet(
        "given_compliance",
        "simulated compliance from the campaign's compliance_file, SI",
        "response* load* coefficient unit",
    ),
    parquet(
        "given_deformation",
        "simulated K from the campaign's deformation_file: shift of an attachment along z per displacement of an "
        "actuator",
        "leg* column* coefficient sigma unit",
    ),
    parquet(
        "published",
        "published displacements under load, from the campaign's table `published`",
        "load* channel* applied* source* published unit",
        optional="published_in",
    ),
    parquet(
        "displacement",
        "displacement of the platform per load case, without zeros and drift of the runs; empty if not measured",
        f"case* branch {WRENCH} dx_mm dy_mm dz_mm rx_rad ry_rad rz_rad {COVARIANCE} n_used n_rejected",
        optional="role",
        version=2,
    ),
    parquet(
        "reading_residuals",
        "readings minus a smooth curve of load and time fitted to their run, and rejected readings",
        "run* step* channel* branch residual sigma unit weight rejected reason",
        optional="decision geometry geometry_sigma",
    ),
    parquet(
        "run_terms",
        "zero and drift of every run and channel, relative to which displacements are counted",
        "run* channel* term* value sigma unit p_value",
    ),
    parquet(
        "exclusions",
        "number of raw rows left out, with the reason",
        "stage subject reason rows by",
    ),
    parquet(
        "exclusion_effects",
        "effect of each [[exclude]]: rows left out, those among them that are gross errors anyway, and the largest "
        "change of a result without the exclusion",
        "entry* subject* by decided_on reason rows gross_anyway largest_change unit over_sigma",
    ),
    parquet(
        "relabelled",
        "targets with another name in the files in some poses, or with a new position after a later survey",
        "body called target from_pose to_pose rows reason",
    ),
    parquet(
        "likely_names",
        "names that no survey has, at the position of a target missing there: a suggestion, never applied",
        "body called target from_pose to_pose rows distance_mm",
    ),
    parquet(
        "resurveys",
        "positions of the targets in a later survey minus their earlier ones, in the frame of the first survey",
        f"later_survey* body* target* shift_x_mm shift_y_mm shift_z_mm {SIGMA} p_value relocated holds_as from_pose "
        "status",
    ),
    parquet(
        "qa",
        "results of all quality checks, one row per check and subject",
        "check subject value limit unit verdict message",
        optional="accepted",
    ),
    parquet(
        "belonging",
        "one row per tested relation between parts of the campaign, with the slips (recording mistakes) that explain "
        "the data",
        "relation subject state reason_code misfit misfit_explained limit unit slips rivals hidden_slips tried "
        "accepted",
    ),
    parquet(
        "poses",
        "rigid-body poses by every estimator, with covariance",
        f"pose* body* parent* method* default {PLACE} {COVARIANCE} rms_mm n_used n_rejected status",
    ),
    parquet(
        "residuals",
        "measured minus fitted points, in the body frame, by the default estimator",
        "pose* body* target* dx_mm dy_mm dz_mm weight rejected reason",
        optional="decision",
    ),
)
