"""Artifacts of photographs: image targets, adjusted network and its uncertainty."""

from __future__ import annotations

from truing.schemas.artifact import parquet

POINT = "x_mm y_mm z_mm"
SIGMA = "sigma_x_mm sigma_y_mm sigma_z_mm"
CORRELATION = "corr_xy corr_xz corr_yz"
_IMAGE = "pose image camera"
_CIRCLE = "semi_major_px semi_minor_px axis_angle_rad contrast"
PLACE = "px_mm py_mm pz_mm rx_rad ry_rad rz_rad"
COVARIANCE = " ".join(f"cov_{i}_{j}" for i in range(6) for j in range(i, 6))
_FORMAT = "width_px height_px balancing_radius_px pixel_um"
# Names of reference lengths that are no bars: distances of the survey, and diagonals of markers.
FROM_SURVEY, FROM_MARKER = "survey, ", "marker, "
# Figures of bundle_statistics on a camera that changed: shift of the points of a pose, and test of one camera.
BENT = "points moved by a camera that changed, over sigma"
SHARED = "one principal distance of all images, p-value"
# Figures on a source or check of the scale, by its name.
LENGTH, LENGTH_SIGMA = "lengths over those of the rays", "lengths over those of the rays, sigma"
_BAR = "bar first second length_mm sigma_mm repeat_sigma_mm serves"

PHOTOGRAPHS = (
    parquet(
        "image_points",
        "rays: measured image position of each target in each photograph",
        f"{_IMAGE} point body target kind x_px y_px cov_xx_px2 cov_xy_px2 cov_yy_px2",
        optional=f"{_CIRCLE}",
    ),
    parquet(
        "photographs",
        "photographs: camera, format, and the principal distance given by their files",
        "pose* image* camera file width_px height_px principal_distance_px",
        optional="principal_distance_from taken_at grey_bits targets_measured image_remark",
    ),
    parquet(
        "image_rejections",
        "number of rejected target candidates in an image, with the reason",
        "pose image kind reason rows",
    ),
    parquet(
        "image_targets",
        "target and body of each code, and the size of the target",
        "family* code* body target",
        optional="diameter_mm size_mm",
    ),
    parquet(
        "scale_bars",
        "calibrated distances between two points",
        f"{_BAR}",
        optional="pose expansion_per_k reference_temperature_c",
    ),
    parquet(
        "known_points",
        "points with known coordinates; a row without pose holds for every pose",
        f"point {POINT} {SIGMA}",
        optional=f"pose {CORRELATION}",
    ),
    parquet(
        "cameras_given",
        "given camera parameters: start values, or fixed values",
        f"camera* parameter* unit value free {_FORMAT}",
    ),
    parquet(
        "object_points",
        "object points of every pose, adjusted from the rays, in the measurement frame of the pose",
        f"pose* point* body target {POINT} {SIGMA} {CORRELATION} rays largest_angle_deg rms_px",
    ),
    parquet(
        "point_correlations",
        "correlations between different points of a pose (those within one point are in object_points)",
        "pose* point* other_point* corr_x_x corr_x_y corr_x_z corr_y_x corr_y_y corr_y_z corr_z_x corr_z_y corr_z_z",
    ),
    parquet(
        "point_sensitivities",
        "effect of errors common to all poses (cameras, scale bars) on each point",
        "pose* point* parameter* effect_x_mm effect_y_mm effect_z_mm",
    ),
    parquet(
        "pose_sensitivities",
        "effect of errors common to all poses on the default pose of each body, in the frame of its parent",
        "pose* body* parent parameter* effect_x_mm effect_y_mm effect_z_mm effect_rx_rad effect_ry_rad effect_rz_rad",
    ),
    parquet(
        "pose_covariances",
        "covariances between the default poses of different bodies in the same pose, in the frame of their parent, "
        "with errors common to all poses",
        "pose* measured_number* other_number* joint_covariance",
    ),
    parquet(
        "shift_covariances",
        "covariances between attachment shifts, and with default poses of bodies, in the same pose, with errors "
        "common to all poses but not those of the survey",
        "pose* measured_number* other_number* joint_covariance",
    ),
    parquet(
        "survey_covariances",
        "covariances that errors of the survey cause in default poses of bodies and, through the platform's frame, "
        "in attachment shifts; the same in all poses",
        "measured_number* other_number* joint_covariance",
    ),
    parquet(
        "shift_sensitivities",
        "effect of errors common to all poses on the shift of each attachment",
        "pose* leg* parameter* effect_um",
    ),
    parquet(
        "cameras",
        "adjusted camera parameters",
        f"camera* parameter* unit value sigma free {_FORMAT}",
    ),
    parquet(
        "camera_correlations",
        "correlations between the parameters common to all poses, of cameras (camera and parameter) and of scale bars",
        "parameter* other_parameter* correlation",
    ),
    parquet(
        "image_orientations",
        "position and orientation of each camera in the measurement frame of its pose, camera axes x right, y down, "
        "z forward",
        f"pose* image* camera {PLACE} {COVARIANCE} rays rms_px status",
    ),
    parquet(
        "image_residuals",
        "residual and redundancy of every ray, and the reason for each rejection",
        f"{_IMAGE} point kind x_px y_px vx_px vy_px sigma_x_px sigma_y_px redundancy_x redundancy_y test_value "
        "eccentricity_x_px eccentricity_y_px rejected reason",
    ),
    parquet(
        "scale_bar_lengths",
        "adjusted and calibrated length of every scale bar in every pose",
        "pose* bar* first second length_mm sigma_mm repeat_sigma_mm serves adjusted_mm adjusted_sigma_mm "
        "deviation_mm deviation_sigma_mm",
    ),
    parquet(
        "image_cameras",
        "principal distance of each photograph, relative to that of most photographs by its camera",
        "pose* image* camera principal_distance_off_px principal_distance_sigma_px setting",
    ),
    parquet(
        "known_point_errors",
        "known coordinates minus those that the rays and the other known points give",
        "pose* point* dx_mm dy_mm dz_mm sigma_x_mm sigma_y_mm sigma_z_mm p_value rays rejected reason",
    ),
    parquet(
        "bundle_statistics",
        "figures of the adjustment: unknowns, redundancy, sigma0, variance components, geometry of the network",
        "figure* subject* value unit",
    ),
    parquet(
        "ray_statistics",
        "slope of each pose's log likelihood by parameters that all poses share: cameras, scale bars, air",
        "pose* shared_number* shared_unit shared_scale shared_sigma shared_mean score",
    ),
    parquet(
        "ray_information",
        "information of each pose's rays on these parameters, by pairs",
        "pose* shared_number* other_number* information",
    ),
    parquet(
        "ray_effects",
        "shift of a pose's points if one of these parameters changed in that pose alone",
        "pose* point* shared_number* moves_x_mm moves_y_mm moves_z_mm",
    ),
)


def subject_and_name(number: str) -> tuple[str, str, str]:
    """Return kind and name of the owner of a shared parameter, and its own name: camera, A, c for ``camera A c``."""
    kind, _, owner_and_name = number.partition(" ")
    owner, _, name_of_part = owner_and_name.rpartition(" ")
    return kind, owner, name_of_part
