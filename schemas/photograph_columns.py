"""Columns of photographs, cameras and the bundle adjustment."""

from __future__ import annotations

from truing.schemas.column import flag, integer, real, share, size, text

_AXES = "xyz"

PHOTOGRAPH_COLUMNS = (
    text("image", "photograph, by a name that is unique within its pose"),
    text("camera", "camera that took it"),
    text("point", "object point: body/target, else the name from its code; empty if uncoded"),
    text(
        "kind",
        "kind of target",
        choices=("ring8", "ring12", "ring14", "circle", "aruco", "apriltag", "charuco", "chessboard"),
    ),
    *(real(f"{a}_px", "px", f"image coordinate along {a}; the centre of the first pixel is 0") for a in "xy"),
    *(
        real(f"cov_{a}{b}_px2", "px^2", f"covariance of the image coordinates along {a} and {b}")
        for a, b in ("xx", "xy", "yy")
    ),
    size("semi_major_px", "px", "semi-major axis of a circle's image", nullable=True),
    size("semi_minor_px", "px", "semi-minor axis of a circle's image", nullable=True),
    real("axis_angle_rad", "rad", "direction of the major axis, from x towards y", nullable=True),
    size("contrast", "", "edge height of the target over the noise of the image", nullable=True),
    text("file", "file of the photograph; empty if its rays were measured elsewhere", nullable=True),
    integer("width_px", "width of the format in pixels", minimum=1, nullable=True),
    integer("height_px", "height of the format in pixels", minimum=1, nullable=True),
    size("principal_distance_px", "px", "start value from the file; empty: unknown", nullable=True),
    # Files of photographs.
    text("principal_distance_from", "entry of the file that gives the principal distance; empty: none", nullable=True),
    text("taken_at", "time of the camera's clock as ISO 8601; empty: not recorded", nullable=True),
    integer("grey_bits", "bits of a grey value", minimum=1),
    integer("targets_measured", "number of targets measured in it; for a marker or a board, of its corners", minimum=0),
    text("image_remark", "remark about the photograph; empty: none", nullable=True),
    # Cameras.
    flag("free", "whether it is estimated"),
    size("balancing_radius_px", "px", "radius at which the radial distortion is zero by definition; 0: at the centre"),
    size("pixel_um", "um", "pixel pitch", nullable=True),
    real(
        "principal_distance_off_px",
        "px",
        "principal distance of the photograph minus that of most photographs by its camera",
    ),
    size("principal_distance_sigma_px", "px", "standard deviation of principal_distance_off_px"),
    integer(
        "setting",
        "0: as most photographs by its camera; 1, 2, ..: groups that share another principal distance",
        minimum=0,
    ),
    # Prior knowledge.
    text("family", "family of coded targets"),
    text("code", "code within its family"),
    size("diameter_mm", "mm", "diameter of a circular target", nullable=True),
    size("size_mm", "mm", "edge length of a square marker", nullable=True),
    text("bar", "name of the scale bar"),
    text("first", "point at one end"),
    text("second", "point at the other end"),
    text("serves", "whether it defines or checks the scale", choices=("scale", "check")),
    size("length_mm", "mm", "calibrated length"),
    size("sigma_mm", "mm", "standard deviation of the calibrated length, common to all poses"),
    size("repeat_sigma_mm", "mm", "standard deviation of a single distance about the calibrated length"),
    real("expansion_per_k", "1/K", "thermal expansion of the bar", nullable=True),
    real("reference_temperature_c", "degC", "temperature of the calibrated length", minimum=-273.15, nullable=True),
    # Adjusted network.
    integer("rays", "number of rays in the adjustment", minimum=0),
    size("largest_angle_deg", "deg", "largest angle between two rays to the point", nullable=True),
    text("other_point", "other point of the correlation"),
    *(
        real(f"corr_{a}_{b}", "", f"correlation of {a} of the point and {b} of the other", minimum=-1.0, maximum=1.0)
        for a in _AXES
        for b in _AXES
    ),
    *(real(f"effect_{a}_mm", "mm", f"change of {a} for one standard deviation of the common parameter") for a in _AXES),
    *(
        real(f"effect_r{a}_rad", "rad", f"rotation about {a} for one standard deviation of the common parameter")
        for a in _AXES
    ),
    real("effect_um", "um", "change of the shift for one standard deviation of the common parameter"),
    text("measured_number", "number measured in the pose: `platform px` .. `leg6 rz`, `shift 1` .. by leg"),
    real("joint_covariance", "SI", "covariance of the two numbers; units as in cov_0_0 .. cov_5_5"),
    *(real(f"v{a}_px", "px", f"residual along {a}: measured minus adjusted", nullable=True) for a in "xy"),
    *(size(f"sigma_{a}_px", "px", f"standard deviation of {a} used in the adjustment") for a in "xy"),
    *(share(f"redundancy_{a}", f"redundancy number of {a}", nullable=True) for a in "xy"),
    size("test_value", "", "larger of the two standardised residuals", nullable=True),
    *(
        real(f"eccentricity_{a}_px", "px", f"correction subtracted from {a} for the eccentricity of the circle's image")
        for a in "xy"
    ),
    size("rms_px", "px", "root mean square of the residuals of the rays used", nullable=True),
    real("adjusted_mm", "mm", "length between the adjusted points"),
    size("adjusted_sigma_mm", "mm", "standard deviation of adjusted_mm"),
    real("deviation_mm", "mm", "adjusted minus calibrated length"),
    size("deviation_sigma_mm", "mm", "standard deviation of deviation_mm"),
    # Information of rays on shared parameters.
    text("shared_number", "parameter that poses share: its subject and name"),
    text("other_number", "second parameter or number of the pair"),
    text("shared_unit", "unit of the parameter"),
    size("shared_scale", "", "scale unit of the parameter, in its unit"),
    size("shared_sigma", "", "prior standard deviation in the adjustment, in its unit; empty: no prior", nullable=True),
    real("shared_mean", "", "prior value minus adjusted value, in its unit"),
    real("score", "", "derivative of the rays' log likelihood by the parameter at its adjusted value, per scale"),
    real("information", "", "curvature of the log likelihood by the two parameters, per scale of each"),
    *(real(f"moves_{a}_mm", "mm", f"change of {a} per scale of the parameter in this pose alone") for a in _AXES),
)
