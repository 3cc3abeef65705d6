"""Expected columns of each raw table, for the checks before those across tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.column import Column
from truing.schemas.columns import COLUMNS, find_column
from truing.schemas.covariates import OF_LOADS, is_marked

_POINT = ("x_mm", "y_mm", "z_mm")
_SPREAD = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "corr_xy", "corr_xz", "corr_yz")
_WRENCH = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
_MOTION = ("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad")
_SHOWN = ("shown_fx_n", "shown_fy_n", "shown_fz_n", "shown_mx_nm", "shown_my_nm", "shown_mz_nm")
_SURROUNDINGS = ("air_temperature_c", "air_pressure_hpa", "relative_humidity_pct", "material_temperature_c")
TRANSIT = "transit"
_DISTORTION = ("A1", "A2", "A3", "B1", "B2", "C1", "C2")
_CIRCLE = ("semi_major_px", "semi_minor_px", "axis_angle_rad", "contrast")
_SHIFTS = ("m03", "m13", "m23")
# Columns of a raw table alone; the unit of a load or reading depends on its axis or channel.
_RAW: tuple[Column, ...] = (
    Column("from", "text", "one end of a distance: a target, or station:NAME"),
    Column("to", "text", "other end of a distance: a target, or station:NAME"),
    Column("survey", "text", "which of the later surveys a target was seen in"),
    Column("load_axis", "text", "the axis that is loaded", choices=("fx", "fy", "fz", "mx", "my", "mz")),
    Column("load", "real", "load along that axis, N or N m", nullable=True),
    Column("channel", "text", "the motion that was read", choices=("dx", "dy", "dz", "rx", "ry", "rz")),
    *(Column(f"signal_{a}", "real", f"quadrature signal {a}, any unit", nullable=True) for a in "xy"),
    Column("phase_deg", "real", "phase of the quadrature signals", "deg", nullable=True),
    Column("radius", "real", "length of the quadrature signals together, any unit", nullable=True),
    Column(
        TRANSIT,
        "integer",
        "1 for a sample taken on the way to the next load: it counts fringes, and enters no mean; else 0",
        minimum=0,
        maximum=1,
        nullable=True,
    ),
    Column("reading", "real", "what the channel read, um or arcsec", nullable=True),
    *(Column(f"shown_f{a}_n", "real", f"force along {a} as the sensor itself shows it", "N") for a in "xyz"),
    *(Column(f"shown_m{a}_nm", "real", f"torque about {a} as the sensor itself shows it", "N m") for a in "xyz"),
    Column("deviation_um", "real", "position minus target, where a file gives no position", "um", nullable=True),
    Column("c_mm", "real", "principal distance", "mm", minimum=0.0, nullable=True),
    Column("focal_px", "real", "principal distance", "px", minimum=0.0, nullable=True),
    *(Column(f"{a}0_px", "real", "principal point from the middle of the format", "px", nullable=True) for a in "xy"),
    *(Column(name, "real", "distortion, its length in px", nullable=True) for name in _DISTORTION),
    Column("free", "text", "parameters to estimate, separated by blanks", nullable=True),
    Column("theoretical_maximum", "real", "published theory at the load, um or arcsec", nullable=True),
    Column("measured_positive", "real", "published measurement at the positive load, um or arcsec", nullable=True),
    Column("measured_negative", "real", "published measurement at the negative load, um or arcsec", nullable=True),
    Column("figure", "text", "figure or table of the publication", nullable=True),
)
_QUATERNION = ("qw", "qx", "qy", "qz")
_VECTOR = ("rx_rad", "ry_rad", "rz_rad")
_EULER = ("euler_a_deg", "euler_b_deg", "euler_c_deg")
_MATRIX = tuple(f"m{i}{j}" for i in range(4) for j in range(4))
_POSE_SIGMAS = tuple(f"sigma_{name}" for name in (*_POINT, *_VECTOR, *_EULER))
_POSE_COVARIANCE = tuple(f"cov_{i}_{j}" for i in range(6) for j in range(i, 6))
_RAW += (
    *(Column(name, "real", "component of the unit quaternion, body to parent", nullable=True) for name in _QUATERNION),
    *(Column(name, "real", "angle about that axis of [poses] euler", "deg", nullable=True) for name in _EULER),
    *(
        Column(
            name, "real", "element of the 4x4 matrix, body to parent", "mm" if name in _SHIFTS else "", nullable=True
        )
        for name in _MATRIX
    ),
    *(
        Column(name, "real", "one standard deviation", name.rsplit("_", 1)[-1], minimum=0.0, nullable=True)
        for name in _POSE_SIGMAS[3:]
    ),
)
_CARRIED_UNITS = (
    ("_mm", "mm"),
    ("_um", "um"),
    ("_deg", "deg"),
    ("_rad", "rad"),
    ("_c", "degC"),
    ("_s", "s"),
    ("_n", "N"),
)


@dataclass(frozen=True)
class RawTable:
    """A raw table: required and optional columns, a numbered family, and whether other numbers are included.

    ``partial``: only some columns of a table are read, and its mapping may name more; ``may_be_empty``: columns that
    need a value in every row of other tables only.
    """

    name: str
    required: tuple[str, ...]
    optional: tuple[str, ...] = ()
    family: str | None = None
    covariates: bool = False
    partial: bool = False
    may_be_empty: tuple[str, ...] = ()

    def column(self, name: str) -> Column | None:
        """Return the definition of a column of this table or of a covariate; None for other names."""
        known = _defined(name)
        if known is not None and self._allows(known, name):
            return replace(known, nullable=True) if name in self.may_be_empty else known
        return Column(name, "real", "covariate", _carried_unit(name), nullable=True) if self.covariates else None

    def is_covariate(self, name: str) -> bool:
        """True if a column would be included as a covariate, and is not one of this table's own."""
        known = _defined(name)
        return self.covariates and not (known is not None and self._allows(known, name))

    def is_set_apart(self, name: str) -> bool:
        """True if a covariate has the name of a column that the run creates; it is then stored under another
        name."""
        made = ARTIFACTS.get(self.name)
        is_added = "run" in self.required and name in OF_LOADS
        is_of_others = made is not None and name in made.optional  # columns of tables of another mechanism
        return (is_added or is_of_others or is_marked(name)) and self.is_covariate(name)

    def _allows(self, known: Column, name: str) -> bool:
        return name in (*self.required, *self.optional) or (self.family is not None and known.name == self.family)

    def known(self, names: tuple[str, ...]) -> Iterator[str]:
        """Yield the contract's columns that this table may have, with those of its family among ``names``."""
        yield from (*self.required, *self.optional)
        if self.family is not None:
            yield from (name for name in names if re.fullmatch(COLUMNS[self.family].family, name))

    @property
    def has_coordinates(self) -> bool:
        """True if rows are positions in space: points or poses."""
        return "x_mm" in (*self.required, *self.optional)


def _defined(name: str) -> Column | None:
    return next((column for column in _RAW if column.name == name), None) or find_column(name)


def _carried_unit(name: str) -> str:
    return next((unit for ending, unit in _CARRIED_UNITS if name.endswith(ending)), "")


POINTS = RawTable("points", ("pose", *_POINT), ("body", "target", *_SPREAD))
TARGETS = RawTable("targets", ("body", "target", *_POINT), (*_SPREAD, "leg"))
RESURVEYS = RawTable("resurveys", ("survey", "body", "target", *_POINT), (*_SPREAD, "leg"))
POSES = RawTable(
    "poses",
    ("pose", "body"),
    (*_POINT, *_QUATERNION, *_VECTOR, *_EULER, *_MATRIX, *_POSE_SIGMAS, *_POSE_COVARIANCE),
)
DISTANCES = RawTable("distances", ("pose", "from", "to", "distance_mm"), ("sigma_mm",), may_be_empty=("sigma_mm",))
SCANS = RawTable("scans", ("pose", "body", *_POINT))
SURFACES = RawTable("surfaces", ("body", *_POINT))
CONFIGURATIONS = RawTable(
    "configurations",
    ("pose",),
    ("role", "time_s", "temperature_c", "repeat_of", "series"),
    family="rho",
    covariates=True,
)
_LOADED = (*_WRENCH, "load_axis", "load", "role", TRANSIT)
DISPLACEMENT = RawTable(
    "displacement", ("run", "step", "time_s"), (*_MOTION, *_LOADED, *_SURROUNDINGS), covariates=True
)
INTERFEROMETER = RawTable(
    "interferometer",
    ("run", "step", "time_s", "channel", "reading"),
    ("sigma", *_LOADED, *_SURROUNDINGS),
    covariates=True,
)
# Planned steps have no readings yet; without a channel, all channels will be read.
PLANNED = RawTable(
    "interferometer", ("run", "step", "time_s"), ("channel", "reading", *INTERFEROMETER.optional), covariates=True
)
SIGNALS = RawTable(
    "signals", ("run", "step"), ("time_s", *_SHOWN, *_LOADED, *_SURROUNDINGS), family="signal", covariates=True
)
# Loads that another instrument recorded than the signals; [files.loads] says how its rows belong to those of signals.
LOADS_APART = RawTable("loads", (), ("run", "step", "time_s", *_LOADED))
# What recorded an axis in another file than its commands; [files.measured] says how its rows belong to these.
MEASURED_APART = RawTable("measured", (), ("pose", "time_s"), covariates=True)

QUADRATURE = RawTable(
    "quadrature",
    ("run", "step", "channel"),
    ("time_s", "signal_x", "signal_y", "phase_deg", "radius", "sigma", *_LOADED, *_SURROUNDINGS),
    covariates=True,
)
POSITIONING = RawTable(
    "positioning", ("run", "target_mm", "direction", "cycle"), ("position_mm", "deviation_um", *_SURROUNDINGS)
)
PUBLISHED = RawTable(
    "published",
    ("load_axis", "load", "channel"),
    ("theoretical_maximum", "measured_positive", "measured_negative", "unit", "figure"),
)

IMAGE_POINTS = RawTable(
    "image_points",
    ("pose", "image", "x_px", "y_px"),
    (
        *("camera", "point", "body", "target", "kind", "sigma_x_px", "sigma_y_px"),
        *("cov_xx_px2", "cov_xy_px2", "cov_yy_px2", *_CIRCLE),
    ),
    may_be_empty=("point", "body", "target", "kind", "sigma_x_px", "sigma_y_px"),
)
IMAGE_TARGETS = RawTable("image_targets", ("family", "code", "body", "target"), ("diameter_mm", "size_mm"))
SCALE_BARS = RawTable(
    "scale_bars",
    ("bar", "first", "second", "length_mm", "sigma_mm"),
    ("repeat_sigma_mm", "serves", "expansion_per_k", "reference_temperature_c", "pose"),
    may_be_empty=("repeat_sigma_mm", "serves"),
)
KNOWN_POINTS = RawTable(
    "known_points", _POINT, ("pose", "point", "body", "target", *_SPREAD), may_be_empty=("point", "body", "target")
)
CAMERAS = RawTable(
    "cameras",
    ("camera",),
    (
        *("width_px", "height_px", "pixel_um", "c_mm", "focal_px", "x0_px", "y0_px", *_DISTORTION),
        *("balancing_radius_px", "free"),
    ),
    may_be_empty=("balancing_radius_px",),
)

COORDINATES = _POINT
COORDINATE_SIGMAS = _POSE_SIGMAS[:3]
WRENCH = _WRENCH
QUATERNION = _QUATERNION
ROTATION_VECTOR = _VECTOR
EULER = _EULER
POSE_COVARIANCE = _POSE_COVARIANCE
MOTION = _MOTION
SHOWN_WRENCH = _SHOWN
