"""Sections of campaign.toml other than [mechanism]: loads, noise, decisions and limits."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from truing.schemas.column import LEAST_SIGMA_MM, MOST_SIGMA_MM
from truing.schemas.section import (
    TYPED,
    Day,
    Finite,
    Identifier,
    Name,
    NotNegative,
    OneOrSeveral,
    Path,
    Positive,
    Section,
    Shown,
    Vector,
    Words,
)

OverloadFactor = Annotated[float, Field(ge=1.0, le=10.0, allow_inf_nan=False)]


class CampaignSection(Section):
    """[campaign]: name, kind, and columns on which deformation may depend."""

    name: Shown = Field(pattern=r"^[^/\\:*?\"<>|\x00-\x1f]{1,120}$", description="name of the run's folder")
    kind: Literal["photogrammetry", "interferometer"] = Field(
        description="photogrammetry: points of bodies; interferometer: motion of a platform under load"
    )
    drives: tuple[Name, ...] = Field((), description="columns of configurations.csv on which deformation may depend")
    title: Words | None = Field(None, description="title of the page; absent: the name")
    laboratory: Words | None = Field(
        None, description="laboratory, as shown on the page; absent: certificate.laboratory.name"
    )
    customer: Words | None = Field(
        None, description="customer, as shown on the page; absent: certificate.customer.name"
    )
    operator: Words | None = Field(None, description="who measured, as shown on the page")
    logo: Path | None = Field(None, description="picture at the top of the page: PNG, JPEG or SVG of at most 1 MB")


class Comment(Section):
    """[[comment]]: sentences of a person, shown in a section of the page."""

    section: Name = Field(description="section of the page, by its id, as in its address: report.html#calibration")
    text: Words = Field(description="sentences; a line end begins a new paragraph")


class Overload(Section):
    """[loading.overload]: largest load of an overload test, as a multiple of the range."""

    fx: OverloadFactor = Field(1.0, description="for the force along x")
    fy: OverloadFactor = Field(1.0, description="for the force along y")
    fz: OverloadFactor = Field(1.0, description="for the force along z")
    mx: OverloadFactor = Field(1.0, description="for the torque about x")
    my: OverloadFactor = Field(1.0, description="for the torque about y")
    mz: OverloadFactor = Field(1.0, description="for the torque about z")


_LEAST_ARM_MM = 1.0  # a shorter arm is in metres, or none


class LoadingUnit(Section):
    """[loading.units.<load>]: two units that apply one load together, at opposite points of the platform."""

    arm_mm: Vector = Field(description="from the platform origin to the first unit; the second is opposite")


class LoadingUnits(Section):
    """[loading.units]: loads that two units apply together; a force is shared, a torque is their couple."""

    fx: LoadingUnit | None = Field(None, description="units of the force along x")
    fy: LoadingUnit | None = Field(None, description="units of the force along y")
    fz: LoadingUnit | None = Field(None, description="units of the force along z")
    mx: LoadingUnit | None = Field(None, description="units of the torque about x")
    my: LoadingUnit | None = Field(None, description="units of the torque about y")
    mz: LoadingUnit | None = Field(None, description="units of the torque about z")

    @model_validator(mode="after")
    def _arms_lie_across(self) -> LoadingUnits:
        for load, arm in self.arms_mm.items():
            along = "xyz".index(load[1])
            across = math.hypot(*(part for index, part in enumerate(arm) if index != along))
            if across < _LEAST_ARM_MM:
                expected = f"arm_mm of {load} with at least {_LEAST_ARM_MM:g} mm across {load[1]}"
                raise ValueError(f"{expected}, not {across:g}: units on the axis share no moment")
            if load.startswith("m") and abs(arm[along]) > TYPED * across:
                raise ValueError(f"arm_mm of {load} perpendicular to {load[1]}, not with {arm[along]:g} mm along it")
        return self

    @property
    def arms_mm(self) -> dict[str, Vector]:
        """Declared arms by load."""
        declared = ((load, getattr(self, load)) for load in type(self).model_fields)
        return {load: unit.arm_mm for load, unit in declared if unit is not None}


class Loading(Section):
    """[loading]: range of each load; a larger load is a fault, except in an overload test."""

    fx_n: Positive | None = Field(None, description="largest force along x, in both directions")
    fy_n: Positive | None = Field(None, description="largest force along y, in both directions")
    fz_n: Positive | None = Field(None, description="largest force along z, in both directions")
    mx_nm: Positive | None = Field(None, description="largest torque about x, in both directions")
    my_nm: Positive | None = Field(None, description="largest torque about y, in both directions")
    mz_nm: Positive | None = Field(None, description="largest torque about z, in both directions")
    overload: Overload = Field(
        Overload(),
        description="largest load of an overload test over the range (1.2: 120 %): one number, or one per load",
    )

    units: LoadingUnits = Field(
        LoadingUnits(),
        description="loads that two units apply together, and where they act: { fz = { arm_mm = [..] } }",
    )

    @field_validator("overload", mode="before")
    @classmethod
    def _same_for_all(cls, value: object) -> object:
        if isinstance(value, int | float):
            return dict.fromkeys(Overload.model_fields, value)
        if not isinstance(value, dict | Overload):
            raise ValueError("one number, or one per load: { fx = .., mz = .. }")
        return value

    def allowed(self, load: str) -> float | None:
        """Largest allowed load of a column (fx_n), overload test included; None without a range."""
        largest = getattr(self, load)
        return None if largest is None else float(largest * getattr(self.overload, load.partition("_")[0]))


class SignalChain(Section):
    """[signals] chain: the single-axis force cells and their amplifier, as their data sheets state them."""

    rated_load_n: Positive = Field(description="load of one cell that gives its rated output")
    output_mv_per_v: Positive = Field(description="rated output of a cell per volt of supply")
    output_sigma_mv_per_v: NotNegative = Field(0.0, description="one sigma of it, independent from cell to cell")
    supply_v: Positive = Field(description="supply voltage of the cells")
    amplification: Positive = Field(1.0, description="recorded signal over the output of a cell")
    amplification_sigma: NotNegative = Field(0.0, description="one sigma of it, relative, independent of the others")

    @property
    def sensitivity_mv_per_n(self) -> float:
        """Recorded signal per load of one cell (force-sensor paper, eq. 33)."""
        return self.amplification * self.output_mv_per_v * self.supply_v / self.rated_load_n

    @property
    def tolerance(self) -> float:
        """One sigma of the sensitivity, relative."""
        return math.hypot(self.output_sigma_mv_per_v / self.output_mv_per_v, self.amplification_sigma)


class Signals(Section):
    """[signals]: prior knowledge of the gain of the signal channels."""

    sensitivity_mv_per_n: OneOrSeveral | None = Field(
        None, description="gain of the channels: one number, or one per channel; absent: unknown"
    )
    sensitivity_tolerance: NotNegative | None = Field(None, description="relative standard deviation of the gain")
    zero_mv: NotNegative | None = Field(
        None, description="standard deviation of a signal's zero, if each run was tared; absent: unknown"
    )
    range_mv: Positive | None = Field(
        None, description="range of the amplifier, in both directions; signals at its ends are clipped"
    )
    average_samples: bool = Field(
        False,
        description="rows of one step, or in succession with equal loads, are samples, and their mean is used",
    )
    chain: SignalChain | None = Field(
        None, description="cells and amplifier, in place of sensitivity_mv_per_n and sensitivity_tolerance"
    )

    @model_validator(mode="after")
    def _sensitivity_of_the_chain(self) -> Signals:
        if self.chain is None:
            return self
        keys_of_chain = {
            "sensitivity_mv_per_n": self.chain.sensitivity_mv_per_n,
            "sensitivity_tolerance": self.chain.tolerance,
        }
        for name, value in keys_of_chain.items():
            given = getattr(self, name)
            if given is not None and given != value:
                raise ValueError(f"chain alone: it gives {name} = {value:.6g}; leave {name} out")
        return self.model_copy(update=keys_of_chain)


OF_LOADS = ("_n", "_nm")  # ends of the keys of forces and torques


class PoseComponents(Section):
    """One number for each component of a pose; absent: not specified."""

    x_mm: Positive | None = Field(None, description="along x")
    y_mm: Positive | None = Field(None, description="along y")
    z_mm: Positive | None = Field(None, description="along z")
    rx_deg: Positive | None = Field(None, description="about x")
    ry_deg: Positive | None = Field(None, description="about y")
    rz_deg: Positive | None = Field(None, description="about z")


class Workspace(PoseComponents):
    """[workspace]: half ranges for pose selection and the requirements table."""

    rho_mm: Positive | None = Field(None, description="for every actuator, about its reference reading")
    joints: dict[str, tuple[Finite, Finite]] = Field(
        default_factory=dict,
        description="chain: lowest and highest reading of joints, by column (`elbow_deg = [-90, 90]`); absent: the "
        "limits of the URDF, else the range of the measured readings",
    )

    @field_validator("joints")
    @classmethod
    def _joints_move(cls, joints: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        if wrong := [f"{name} = [{low:g}, {high:g}]" for name, (low, high) in joints.items() if low >= high]:
            raise ValueError(f"the lowest reading before the highest, not {', '.join(wrong)}")
        return joints


class Requirement(PoseComponents):
    """[requirement]: required accuracy of the poses of a mechanism, or of the loads of a force sensor."""

    fx_n: Positive | None = Field(None, description="force sensor: of the force along x")
    fy_n: Positive | None = Field(None, description="force sensor: of the force along y")
    fz_n: Positive | None = Field(None, description="force sensor: of the force along z")
    mx_nm: Positive | None = Field(None, description="force sensor: of the torque about x")
    my_nm: Positive | None = Field(None, description="force sensor: of the torque about y")
    mz_nm: Positive | None = Field(None, description="force sensor: of the torque about z")

    def of_loads(self) -> dict[str, float]:
        """Limits on loads by key."""
        return {name: value for name, value in self if value is not None and name.endswith(OF_LOADS)}


def _check_zero_or_plausible(value: float) -> float:
    if 0.0 < value < LEAST_SIGMA_MM:
        raise ValueError(f"0, or at least {LEAST_SIGMA_MM:g}")
    return value


# Plausible standard deviations of an instrument, in the unit of the key: from below any resolution to beyond any
# measurement. 0 means exact.
OfLength = Annotated[float, Field(ge=LEAST_SIGMA_MM, le=MOST_SIGMA_MM, allow_inf_nan=False)]
OfReadings = Annotated[float, Field(ge=0.0, le=1e3, allow_inf_nan=False), AfterValidator(_check_zero_or_plausible)]
OfDisplacement = Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
OfAngles = Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
OfRotation = Annotated[float, Field(ge=1e-12, le=3.2, allow_inf_nan=False)]
OfTurns = Annotated[float, Field(ge=1e-10, le=180.0, allow_inf_nan=False)]
OfSignals = Annotated[float, Field(ge=1e-9, le=1e6, allow_inf_nan=False)]
OfImages = Annotated[float, Field(ge=1e-6, le=1e4, allow_inf_nan=False)]
OfLoads = Annotated[float, Field(ge=0.0, le=1e9, allow_inf_nan=False), AfterValidator(_check_zero_or_plausible)]


class Noise(Section):
    """[noise]: one standard deviation, as specified for the instrument."""

    point_mm: OfLength | None = Field(None, description="photogrammetry: each coordinate of a point")
    image_px: OfImages | None = Field(None, description="photographs: each image coordinate without a sigma of its own")
    actuator_mm: OfReadings = Field(0.0, description="photogrammetry: reading of an actuator")
    linear_um: OfDisplacement | None = Field(None, description="interferometer, linear channels")
    angular_arcsec: OfAngles | None = Field(None, description="interferometer, angular channels")
    signal_mv: OfSignals | None = Field(None, description="signal channels")
    displacement_mm: OfLength | None = Field(
        None, description="six-component displacement and measured poses, translation"
    )
    rotation_rad: OfRotation | None = Field(None, description="six-component displacement and measured poses, rotation")
    command_deg: OfReadings = Field(0.0, description="rotary axis: deviation from its command")
    motor_deg: OfTurns | None = Field(None, description="rotary axis: reading of the motor encoder")
    load_deg: OfTurns | None = Field(None, description="rotary axis: reading of the load encoder")
    measured_deg: OfTurns | None = Field(None, description="rotary axis: reading of the external instrument")
    command_mm: OfReadings = Field(0.0, description="linear axis: deviation from its command")
    motor_mm: OfLength | None = Field(None, description="linear axis: reading of the motor encoder")
    load_mm: OfLength | None = Field(None, description="linear axis: reading of the load encoder")
    measured_mm: OfLength | None = Field(None, description="linear axis: reading of the external instrument")
    joint_deg: OfReadings = Field(0.0, description="chain: reading of a revolute joint")
    joint_mm: OfReadings = Field(0.0, description="chain: reading of a prismatic joint")
    load_n: OfLoads = Field(0.0, description="applied force")
    load_nm: OfLoads = Field(0.0, description="applied torque")


class Bodies(Section):
    """[bodies]: reference body of all poses, and bodies that should not move."""

    reference: Name | None = Field(
        None,
        description="body in whose frame the other bodies' poses are given; absent: a mechanism's base, else the "
        "measurement frame",
    )
    still: tuple[Name, ...] = Field(
        (), description="bodies that should not move, measured in one frame for the whole campaign"
    )


class Measurement(Section):
    """[measurement]: frame of the instrument, and direction of gravity."""

    frame: Literal["pose", "series", "campaign"] = Field(
        "pose",
        description="pose: each pose has its own frame; series: one frame per series (of a chain: column series of "
        "configurations; else treated like pose, which `truing check` reports); campaign: the instrument did not move, "
        "and its frame is used as that of `base` if this body is not measured",
    )
    up: Vector | None = Field(
        None,
        description="upward direction, of any length, in the frame of the reference body (`base` of a mechanism); "
        "without a reference body, in the frame of an instrument that did not move; absent: gravity is "
        "not considered as a cause",
    )

    @field_validator("up")
    @classmethod
    def _up_is_a_direction(cls, up: Vector | None) -> Vector | None:
        if up is not None and not any(up):
            raise ValueError("a direction, such as [0, 0, 1]: three numbers, not all zero")
        return up


class ExternalLoad(Section):
    """[load]: load on the platform of a legged mechanism, besides the weight of its payload."""

    force_n: Vector = Field(
        (0.0, 0.0, 0.0),
        description="force on the platform at its origin, base frame; columns fx_n, fy_n, fz_n of configurations.csv "
        "have precedence, component by component",
    )
    torque_nm: Vector = Field(
        (0.0, 0.0, 0.0),
        description="torque about its origin, base frame; columns mx_nm, my_nm, mz_nm have precedence",
    )

    @property
    def wrench(self) -> tuple[float, ...]:
        """Force and torque, N and N m."""
        return (*self.force_n, *self.torque_nm)


class CalibrationSection(Section):
    """[calibration]: terms that the calibration of a legged mechanism adds to its standard models."""

    deformation: Literal["z", "in-plane"] = Field(
        "z",
        description="z: shifts of the attachments along z of the platform; in-plane: an additional model that "
        "includes the measured shifts along x and y (deformation in-plane in the tables)",
    )


class MeasuredPoses(Section):
    """[poses]: notation of orientations in the table `poses`."""

    euler: str | None = Field(
        None,
        pattern=r"^([XYZ]{3}|[xyz]{3})$",
        description="order of euler_a, euler_b, euler_c: capitals (`XYZ`) for rotating axes, small letters (`xyz`) "
        "for fixed axes",
    )

    @field_validator("euler")
    @classmethod
    def _turns_about_different_axes(cls, order: str | None) -> str | None:
        if order is not None and (order[0] == order[1] or order[1] == order[2]):
            raise ValueError("an order whose neighbouring axes differ, such as XYZ or ZXZ")
        return order


class Diagnosis(Section):
    """[diagnosis]: false-alarm rate, use of findings, and a second campaign that tests the models."""

    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.05, description="probability of any finding if the simulation is correct"
    )
    seed: int = Field(0, ge=0, description="seed of the simulated null distribution")
    apply: tuple[Name, ...] = Field(
        (), description="causes whose effects the main calibration includes if they are found; absent: data as recorded"
    )
    ignore: tuple[Name, ...] = Field((), description="causes that the diagnosis does not search for")
    judge_on: Path | None = Field(
        None,
        description="folder of a second campaign of the same machine, relative to campaign.toml: the models fitted "
        "here predict it, and their errors are listed",
    )

    @model_validator(mode="after")
    def _check_applied_or_ignored(self) -> Diagnosis:
        if both := sorted({*self.apply} & {*self.ignore}):
            raise ValueError(f"{', '.join(both)} in apply or in ignore, not in both: an ignored cause is never found")
        return self


class SetLimits(Section):
    """[qa.limits.<check>]: own limits of a check, instead of the defaults."""

    warn: NotNegative | None = Field(None, description="limit of a warning; absent: the default")
    fail: NotNegative | None = Field(None, description="limit of a failure; absent: the default")
    reason: Words | None = Field(None, description="reason, shown with the verdict")


class QualityLimits(Section):
    """[qa]: false-alarm budget of all failing checks, and own limits."""

    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.01, description="probability that any check fails on a good campaign"
    )
    limits: dict[str, SetLimits] = Field(
        default_factory=dict, description="own limits by check, for checks with settable limits"
    )


class Overrule(Section):
    """[[exclude]], [[keep]]: a point or reading that a person excludes or keeps, with name and reason.

    An absent key matches all: ``body = "platform", target = "P07"`` matches that target in every pose. ``run = 3,
    channel = "dz"`` matches that channel in every step of the run.
    """

    pose: Identifier | None = Field(None, description="pose")
    body: Name | None = Field(None, description="body")
    target: Name | None = Field(None, description="target")
    run: Identifier | None = Field(None, description="interferometer: run")
    step: int | None = Field(None, description="interferometer: load step within its run")
    channel: Literal["dx", "dy", "dz", "rx", "ry", "rz", "v1", "v2", "v3", "v4", "v5", "v6", "v7", "v8"] | None = Field(
        None, description="interferometer: channel"
    )
    by: Name = Field(description="person who decided")
    on: Day | None = Field(None, description="date, as 2026-11-22")
    reason: Words = Field(description="reason")

    @property
    def signed(self) -> str:
        """Person and date of the decision."""
        return self.by if self.on is None else f"{self.by} on {self.on}"


class Acceptance(Section):
    """[[accept]]: a verdict of a quality check that a person accepts, with name and reason."""

    check: Name = Field(description="name of the check in qa.parquet")
    subject: Name | None = Field(None, description="subject of the verdict; absent: all subjects")
    by: Name = Field(description="person who decided")
    on: Day | None = Field(None, description="date, as 2026-11-22")
    reason: Words = Field(description="reason")

    @property
    def signed(self) -> str:
        """Person and date of the decision."""
        return self.by if self.on is None else f"{self.by} on {self.on}"


class Renamed(Section):
    """[[renamed]]: a target with another name in the files in some poses; ``target`` is its name in the campaign.

    ``from_pose`` and ``to_pose`` are in the order of time and included; absent: the first or last pose. All entries act
    at once, so two targets may exchange names.
    """

    body: Name = Field(description="body of the target")
    called: Name = Field(description="name in the files")
    target: Name = Field(description="name in the campaign")
    from_pose: Identifier | None = Field(None, description="first pose with this name; absent: the first of all")
    to_pose: Identifier | None = Field(None, description="last pose with this name; absent: the last of all")
    by: Name | None = Field(None, description="person who declares it")
    reason: Words | None = Field(None, description="reason")


class Resurvey(Section):
    """[[resurvey]]: first pose for which a survey of the table ``resurveys`` holds; without this table it only checks.

    A target at a new position gets a new name from that pose on: ``P07@after``, for a survey called after.
    """

    survey: Name = Field(description="name in the column survey of the table resurveys")
    from_pose: Identifier | None = Field(None, description="first pose for which the survey holds; absent: only check")
    moved: tuple[Name, ...] = Field((), description="targets known to have moved, however little")
    by: Name | None = Field(None, description="person who declares it")
    reason: Words | None = Field(None, description="reason")
