"""Columns of photographs: rays as measured, the network that they make, what its adjustment leaves."""

from __future__ import annotations

from truing.schemas.column import Column, real

_AXES = "xyz"

IMAGES = (
    Column("image", "text", "the photograph, by a name that is its own within its pose"),
    Column("camera", "text", "the camera that took it"),
    Column("point", "text", "the object point: body/target, else the name that its code gives it; empty where uncoded"),
    Column(
        "kind",
        "text",
        "the kind of target",
        choices=("ring8", "ring12", "ring14", "circle", "aruco", "apriltag", "charuco", "chessboard"),
    ),
    *(real(f"{a}_px", "px", f"image coordinate along {a}, the middle of the first pixel at 0") for a in "xy"),
    *(
        real(f"cov_{a}{b}_px2", "px^2", f"covariance of the image coordinates along {a} and {b}")
        for a, b in ("xx", "xy", "yy")
    ),
    real("semi_major_px", "px", "semi-major axis of a circle's image", minimum=0.0, nullable=True),
    real("semi_minor_px", "px", "semi-minor axis of a circle's image", minimum=0.0, nullable=True),
    real("axis_angle_rad", "rad", "direction of the major axis, from x towards y", nullable=True),
    real("contrast", "", "edge of the target over the noise of the image", minimum=0.0, nullable=True),
    Column("file", "text", "the photograph's file; empty where rays were measured elsewhere", nullable=True),
    Column("width_px", "integer", "pixels of the format along x", minimum=1, nullable=True),
    Column("height_px", "integer", "pixels of the format along y", minimum=1, nullable=True),
    real(
        "principal_distance_px", "px", "as the file tells it, to start from; empty: unknown", minimum=0.0, nullable=True
    ),
)

OF_FILES = (
    Column(
        "principal_distance_from",
        "text",
        "what in the file tells it; empty: nothing",
        nullable=True,
    ),
    Column("taken_at", "text", "when it was taken, by the camera's clock, as ISO 8601; empty: not told", nullable=True),
    Column("grey_bits", "integer", "bits of a grey value", minimum=1),
    Column("targets_measured", "integer", "targets measured in it; of a marker or a board, its corners", minimum=0),
    Column("image_remark", "text", "what is to be known of the photograph; empty: nothing", nullable=True),
)

CAMERAS = (
    Column("free", "flag", "whether it is estimated"),
    real("balancing_radius_px", "px", "where the radial distortion is zero by definition; 0: in the middle", minimum=0),
    real("pixel_um", "um", "pitch of the pixels", minimum=0.0, nullable=True),
    real("principal_distance_off_px", "px", "principal distance of one photograph less that of most by its camera"),
    real("principal_distance_sigma_px", "px", "one standard deviation of it", minimum=0.0),
    Column("setting", "integer", "0: as most photographs by its camera; 1, 2, ..: those that share another", minimum=0),
    Column("other_parameter", "text", "the parameter that it is correlated with"),
)

KNOWN_BEFOREHAND = (
    Column("family", "text", "the family of coded targets"),
    Column("code", "text", "the code within its family"),
    real("diameter_mm", "mm", "diameter of a circular target", minimum=0.0, nullable=True),
    real("size_mm", "mm", "edge of a square marker", minimum=0.0, nullable=True),
    Column("bar", "text", "the scale bar"),
    Column("first", "text", "the point at one end"),
    Column("second", "text", "the point at the other end"),
    Column("serves", "text", "whether it gives the scale or checks it", choices=("scale", "check")),
    real("length_mm", "mm", "the calibrated length", minimum=0.0),
    real("sigma_mm", "mm", "one standard deviation of it, common to all poses", minimum=0.0),
    real("repeat_sigma_mm", "mm", "by how much one distance differs from it, one standard deviation", minimum=0.0),
    real("expansion_per_k", "1/K", "relative expansion of the bar", nullable=True),
    real("reference_temperature_c", "degC", "temperature of the calibrated length", minimum=-273.15, nullable=True),
)

NETWORK = (
    Column("rays", "integer", "rays that entered the adjustment", minimum=0),
    real("largest_angle_deg", "deg", "largest angle between two rays to the point", minimum=0.0, nullable=True),
    Column("other_point", "text", "the point that its errors are correlated with"),
    *(
        real(f"corr_{a}_{b}", "", f"correlation of {a} of the point and {b} of the other", minimum=-1.0, maximum=1.0)
        for a in _AXES
        for b in _AXES
    ),
    *(
        real(f"effect_{a}_mm", "mm", f"change of {a} by one standard deviation of the parameter common to all poses")
        for a in _AXES
    ),
    *(
        real(f"effect_r{a}_rad", "rad", f"rotation about {a} by one standard deviation of that parameter")
        for a in _AXES
    ),
    real("effect_um", "um", "change of the shift by one standard deviation of that parameter"),
    Column("measured_number", "text", "a number measured in the pose: `platform px` .. `leg6 rz`, `shift 1` .. by leg"),
    real("joint_covariance", "SI", "covariance of the two numbers; of poses as in cov_0_0 .. cov_5_5"),
    *(real(f"v{a}_px", "px", f"residual along {a}: measured minus adjusted", nullable=True) for a in "xy"),
    *(
        real(f"sigma_{a}_px", "px", f"one standard deviation of {a} that the adjustment took", minimum=0.0)
        for a in "xy"
    ),
    *(real(f"redundancy_{a}", "", f"redundancy number of {a}", minimum=0.0, maximum=1.0, nullable=True) for a in "xy"),
    real("test_value", "", "largest of the two standardised residuals", minimum=0.0, nullable=True),
    *(real(f"eccentricity_{a}_px", "px", f"taken off {a} as the eccentricity of the circle's image") for a in "xy"),
    real("rms_px", "px", "root mean square of the residuals of the rays kept", minimum=0.0, nullable=True),
    real("adjusted_mm", "mm", "the length that the adjusted points have"),
    real("adjusted_sigma_mm", "mm", "one standard deviation of it", minimum=0.0),
    real("deviation_mm", "mm", "adjusted minus calibrated length"),
    real("deviation_sigma_mm", "mm", "one standard deviation of that", minimum=0.0),
)

RAYS = (
    Column("shared_number", "text", "a number that poses should share: what it is of, which one, its name"),
    Column("other_number", "text", "the number that it is told together with"),
    Column("shared_unit", "text", "its unit"),
    real("shared_scale", "", "how much of it counts as one, in its unit", minimum=0.0),
    real(
        "shared_sigma",
        "",
        "how well the adjustment knew it beforehand, in its unit; empty: not at all",
        minimum=0.0,
        nullable=True,
    ),
    real("shared_mean", "", "what was known of it beforehand, less its adjusted value, in its unit"),
    real("score", "", "slope of the log likelihood of the rays by it, at its adjusted value, per scale"),
    real("information", "", "curvature of that by the two numbers, per scale of each"),
    *(real(f"moves_{a}_mm", "mm", f"change of {a} per scale of the number in this pose alone") for a in _AXES),
)

PHOTOGRAPHS = (*IMAGES, *OF_FILES, *CAMERAS, *KNOWN_BEFOREHAND, *NETWORK, *RAYS)
