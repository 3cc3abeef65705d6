"""What is left of photographs: targets in images, the adjusted network, and how well it is known."""

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
# What bars are called that are none: distances of the survey, and diagonals of markers.
FROM_SURVEY, FROM_MARKER = "survey, ", "marker, "
# Figures of bundle_statistics on images of one camera that differ: of which pose points move, and of which camera.
BENT = "points moved by a camera that changed, over sigma"
SHARED = "one principal distance of all images, p-value"
# Figures on what gives or checks the scale, by its name.
LENGTH, LENGTH_SIGMA = "lengths over those of the rays", "lengths over those of the rays, sigma"
_BAR = "bar first second length_mm sigma_mm repeat_sigma_mm serves"

PHOTOGRAPHS = (
    parquet(
        "image_points",
        "rays: where each image shows each target",
        f"{_IMAGE} point body target kind x_px y_px cov_xx_px2 cov_xy_px2 cov_yy_px2",
        optional=f"{_CIRCLE}",
    ),
    parquet(
        "photographs",
        "the photographs: camera, format, the principal distance that their files tell",
        "pose* image* camera file width_px height_px principal_distance_px",
        optional="principal_distance_from taken_at grey_bits targets_measured image_remark",
    ),
    parquet(
        "image_rejections",
        "what looked like a target in an image and was rejected, counted, with the reason",
        "pose image kind reason rows",
    ),
    parquet(
        "image_targets",
        "which code is which target of which body, and how large",
        "family* code* body target",
        optional="diameter_mm size_mm",
    ),
    parquet(
        "scale_bars",
        "distances between two points, as calibrated",
        f"{_BAR}",
        optional="pose expansion_per_k reference_temperature_c",
    ),
    parquet(
        "known_points",
        "points whose coordinates are known beforehand; without a pose, in every pose",
        f"point {POINT} {SIGMA}",
        optional=f"pose {CORRELATION}",
    ),
    parquet(
        "cameras_given",
        "the cameras as given, to start from or to hold",
        f"camera* parameter* unit value free {_FORMAT}",
    ),
    parquet(
        "object_points",
        "object points of every pose, adjusted from the rays, in the pose's own measurement frame",
        f"pose* point* body target {POINT} {SIGMA} {CORRELATION} rays largest_angle_deg rms_px",
    ),
    parquet(
        "point_correlations",
        "correlations between the points of a pose, those of a point's own coordinates being in object_points",
        "pose* point* other_point* corr_x_x corr_x_y corr_x_z corr_y_x corr_y_y corr_y_z corr_z_x corr_z_y corr_z_z",
    ),
    parquet(
        "point_sensitivities",
        "what the errors common to all poses, those of cameras and scale bars, do to each point",
        "pose* point* parameter* effect_x_mm effect_y_mm effect_z_mm",
    ),
    parquet(
        "pose_sensitivities",
        "what the errors common to all poses do to the default pose of each body, as its parent sees it",
        "pose* body* parent parameter* effect_x_mm effect_y_mm effect_z_mm effect_rx_rad effect_ry_rad effect_rz_rad",
    ),
    parquet(
        "pose_covariances",
        "covariances between the default poses of different bodies, as their parent sees them in the same pose; the "
        "errors common to all poses are in them",
        "pose* measured_number* other_number* joint_covariance",
    ),
    parquet(
        "shift_covariances",
        "covariances of the shifts of attachments with the default poses of bodies and with one another in the same "
        "pose; the errors common to all poses are in them, those of the survey are not",
        "pose* measured_number* other_number* joint_covariance",
    ),
    parquet(
        "survey_covariances",
        "what the errors of the survey bring to the default poses of bodies, and through the platform's frame to the "
        "shifts of attachments, in all poses alike",
        "measured_number* other_number* joint_covariance",
    ),
    parquet(
        "shift_sensitivities",
        "what the errors common to all poses do to the shift of each attachment",
        "pose* leg* parameter* effect_um",
    ),
    parquet(
        "cameras",
        "the cameras as adjusted",
        f"camera* parameter* unit value sigma free {_FORMAT}",
    ),
    parquet(
        "camera_correlations",
        "correlations between the parameters common to all poses: of cameras (camera and parameter) and of scale bars",
        "parameter* other_parameter* correlation",
    ),
    parquet(
        "image_orientations",
        "where each camera stood in the measurement frame of its pose, camera axes x right, y down, z forward",
        f"pose* image* camera {PLACE} {COVARIANCE} rays rms_px status",
    ),
    parquet(
        "image_residuals",
        "every ray: its residual, how well it is controlled, and why it was rejected where it was",
        f"{_IMAGE} point kind x_px y_px vx_px vy_px sigma_x_px sigma_y_px redundancy_x redundancy_y test_value "
        "eccentricity_x_px eccentricity_y_px rejected reason",
    ),
    parquet(
        "scale_bar_lengths",
        "every scale bar in every pose: the adjusted length against the calibrated one",
        "pose* bar* first second length_mm sigma_mm repeat_sigma_mm serves adjusted_mm adjusted_sigma_mm "
        "deviation_mm deviation_sigma_mm",
    ),
    parquet(
        "image_cameras",
        "the principal distance of every photograph by itself, against that of most by its camera",
        "pose* image* camera principal_distance_off_px principal_distance_sigma_px setting",
    ),
    parquet(
        "known_point_errors",
        "known points against the rays: known less where the rays and the other known points have it",
        "pose* point* dx_mm dy_mm dz_mm sigma_x_mm sigma_y_mm sigma_z_mm p_value rays rejected reason",
    ),
    parquet(
        "bundle_statistics",
        "figures of the adjustment: unknowns, redundancy, sigma0, variance components, geometry of the network",
        "figure* subject* value unit",
    ),
    parquet(
        "ray_statistics",
        "what the rays of each pose say of numbers that all poses should share: cameras, scale bars, air",
        "pose* shared_number* shared_unit shared_scale shared_sigma shared_mean score",
    ),
    parquet(
        "ray_information",
        "how surely the rays of each pose say it, by pairs of numbers",
        "pose* shared_number* other_number* information",
    ),
    parquet(
        "ray_effects",
        "how the points of a pose would move if one of these numbers were another one in it",
        "pose* point* shared_number* moves_x_mm moves_y_mm moves_z_mm",
    ),
)
