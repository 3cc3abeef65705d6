"""Sections of campaign.toml beside [mechanism]: what is loaded, how well it is measured, what is decided of it."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from truing.schemas.column import LEAST_SIGMA_MM, MOST_SIGMA_MM
from truing.schemas.section import (
    Day,
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
    """[campaign]: its name, its kind, and the columns that deformation may follow."""

    name: Shown = Field(pattern=r"^[^/\\:*?\"<>|\x00-\x1f]{1,120}$", description="names the run's folder")
    kind: Literal["photogrammetry", "interferometer"] = Field(
        description="photogrammetry: points of bodies; interferometer: motion of a platform under load"
    )
    drives: tuple[Name, ...] = Field((), description="columns of configurations.csv that deformation may follow")


class Overload(Section):
    """[loading.overload]: how far an overload test goes beyond the range, as a multiple of it."""

    fx: OverloadFactor = Field(1.0, description="of the force along x")
    fy: OverloadFactor = Field(1.0, description="of the force along y")
    fz: OverloadFactor = Field(1.0, description="of the force along z")
    mx: OverloadFactor = Field(1.0, description="of the torque about x")
    my: OverloadFactor = Field(1.0, description="of the torque about y")
    mz: OverloadFactor = Field(1.0, description="of the torque about z")


class Loading(Section):
    """[loading]: the range of each load; beyond it a load is a fault, but for an overload test."""

    fx_n: Positive | None = Field(None, description="largest force along x, either way")
    fy_n: Positive | None = Field(None, description="the same along y")
    fz_n: Positive | None = Field(None, description="the same along z")
    mx_nm: Positive | None = Field(None, description="largest torque about x, either way")
    my_nm: Positive | None = Field(None, description="the same about y")
    mz_nm: Positive | None = Field(None, description="the same about z")
    overload: Overload = Field(
        Overload(),
        description="largest load of an overload test over the range (1.2: 120 %): one number, or one per load",
    )

    @field_validator("overload", mode="before")
    @classmethod
    def _one_for_all(cls, given: Any) -> Any:
        if isinstance(given, int | float):
            return dict.fromkeys(Overload.model_fields, given)
        if not isinstance(given, dict | Overload):
            raise ValueError("one number, or one per load: { fx = .., mz = .. }")
        return given

    def allowed(self, load: str) -> float | None:
        """The largest load of a component by its column (fx_n), an overload test included; None where none is said."""
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
    """[signals]: what is known of the gain of the signal channels."""

    sensitivity_mv_per_n: OneOrSeveral | None = Field(
        None, description="gain of the channels, one number or one per channel; absent: unknown"
    )
    sensitivity_tolerance: NotNegative | None = Field(None, description="one sigma of it, relative")
    zero_mv: NotNegative | None = Field(
        None, description="one sigma of a signal's zero where each run was tared; absent: unknown"
    )
    range_mv: Positive | None = Field(None, description="what the amplifier passes either way; at it, a signal is cut")
    chain: SignalChain | None = Field(
        None, description="cells and amplifier, in place of sensitivity_mv_per_n and sensitivity_tolerance"
    )

    @model_validator(mode="after")
    def _sensitivity_of_the_chain(self) -> Signals:
        if self.chain is None:
            return self
        own = {"sensitivity_mv_per_n": self.chain.sensitivity_mv_per_n, "sensitivity_tolerance": self.chain.tolerance}
        for name, value in own.items():
            given = getattr(self, name)
            if given is not None and given != value:
                raise ValueError(f"chain alone: it gives {name} = {value:.6g}; leave {name} out")
        return self.model_copy(update=own)


class PoseComponents(Section):
    """A number for each component of a pose; absent where nothing is said of one."""

    x_mm: Positive | None = Field(None, description="along x")
    y_mm: Positive | None = Field(None, description="along y")
    z_mm: Positive | None = Field(None, description="along z")
    rx_deg: Positive | None = Field(None, description="about x")
    ry_deg: Positive | None = Field(None, description="about y")
    rz_deg: Positive | None = Field(None, description="about z")


class Workspace(PoseComponents):
    """[workspace]: half ranges, for pose selection and the requirements table."""

    rho_mm: Positive | None = Field(None, description="of every actuator, about its reference reading")


class Requirement(PoseComponents):
    """[requirement]: desired accuracy."""


def _is_nothing_or_real(value: float) -> float:
    if 0.0 < value < LEAST_SIGMA_MM:
        raise ValueError(f"0, or at least {LEAST_SIGMA_MM:g}")
    return value


# Standard deviations that an instrument may have, in the unit of the key: from a hundredth of an atom, or from what no
# converter resolves, to what is no measurement any more. 0 is what is taken as exact.
OfLength = Annotated[float, Field(ge=LEAST_SIGMA_MM, le=MOST_SIGMA_MM, allow_inf_nan=False)]
OfReadings = Annotated[float, Field(ge=0.0, le=1e3, allow_inf_nan=False), AfterValidator(_is_nothing_or_real)]
OfDisplacement = Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
OfAngles = Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
OfRotation = Annotated[float, Field(ge=1e-12, le=3.2, allow_inf_nan=False)]
OfTurns = Annotated[float, Field(ge=1e-10, le=180.0, allow_inf_nan=False)]
OfSignals = Annotated[float, Field(ge=1e-9, le=1e6, allow_inf_nan=False)]
OfImages = Annotated[float, Field(ge=1e-6, le=1e4, allow_inf_nan=False)]
OfLoads = Annotated[float, Field(ge=0.0, le=1e9, allow_inf_nan=False), AfterValidator(_is_nothing_or_real)]


class Noise(Section):
    """[noise]: one standard deviation, as specified for the instrument."""

    point_mm: OfLength | None = Field(None, description="photogrammetry: each coordinate of a point")
    image_px: OfImages | None = Field(None, description="photographs: each image coordinate that gives no sigma itself")
    actuator_mm: OfReadings = Field(0.0, description="photogrammetry: an actuator's reading")
    linear_um: OfDisplacement | None = Field(None, description="interferometer, linear channels")
    angular_arcsec: OfAngles | None = Field(None, description="interferometer, angular channels")
    signal_mv: OfSignals | None = Field(None, description="signal channels")
    displacement_mm: OfLength | None = Field(
        None, description="six-component displacement and measured poses, translation"
    )
    rotation_rad: OfRotation | None = Field(None, description="six-component displacement and measured poses, rotation")
    command_deg: OfReadings = Field(0.0, description="rotary axis: how far it stands from its command")
    motor_deg: OfTurns | None = Field(None, description="rotary axis: a reading of the motor's encoder")
    load_deg: OfTurns | None = Field(None, description="rotary axis: a reading of the load's encoder")
    measured_deg: OfTurns | None = Field(None, description="rotary axis: a reading of the outside instrument")
    command_mm: OfReadings = Field(0.0, description="linear axis: how far it stands from its command")
    motor_mm: OfLength | None = Field(None, description="linear axis: a reading of the motor's encoder")
    load_mm: OfLength | None = Field(None, description="linear axis: a reading of the load's encoder")
    measured_mm: OfLength | None = Field(None, description="linear axis: a reading of the outside instrument")
    load_n: OfLoads = Field(0.0, description="applied force")
    load_nm: OfLoads = Field(0.0, description="applied torque")


class Bodies(Section):
    """[bodies]: which body the others are seen from; absent, poses are in the measurement frame.

    ``still`` names bodies that should stand still before an instrument whose frame is one for the campaign.
    """

    reference: Name | None = Field(
        None,
        description="the body that the others are seen from; absent: a mechanism's base, else the measurement's frame",
    )
    still: tuple[Name, ...] = Field(
        (), description="bodies that should stand still before an instrument whose frame is one for the campaign"
    )


class Measurement(Section):
    """[measurement]: how long the frame of the instrument stays one and the same."""

    frame: Literal["pose", "series", "campaign"] = Field(
        "pose",
        description="pose: every pose is measured in a frame of its own; series: one frame per series, taken as "
        "pose, which `truing check` says; campaign: the instrument stood still, and its frame is that of `base` where "
        "this body is not measured",
    )
    up: Vector | None = Field(
        None,
        description="which way is up: a direction of any length in the frame of the reference body (`base` of a "
        "mechanism), or, where nothing is the reference, in that of an instrument that stood still; absent: gravity is "
        "no cause",
    )

    @field_validator("up")
    @classmethod
    def _up_is_a_direction(cls, up: Vector | None) -> Vector | None:
        if up is not None and not any(up):
            raise ValueError("a direction, such as [0, 0, 1]: three numbers, not all zero")
        return up


class MeasuredPoses(Section):
    """[poses]: how the table `poses` writes attitudes."""

    euler: str | None = Field(
        None,
        pattern=r"^([XYZ]{3}|[xyz]{3})$",
        description="order of euler_a, euler_b, euler_c: about turned axes in capitals (`XYZ`), about fixed axes in "
        "small letters (`xyz`)",
    )

    @field_validator("euler")
    @classmethod
    def _turns_about_different_axes(cls, order: str | None) -> str | None:
        if order is not None and (order[0] == order[1] or order[1] == order[2]):
            raise ValueError("an order whose neighbouring axes differ, such as XYZ or ZXZ")
        return order


class Diagnosis(Section):
    """[diagnosis]: how sure a finding must be, what becomes of it, and which second campaign tests the models."""

    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.05, description="probability of any finding where the simulation is right"
    )
    seed: int = Field(0, ge=0, description="seed of the simulated null draws")
    apply: tuple[Name, ...] = Field(
        (), description="causes whose effects the main calibration holds where they are found; absent: data as recorded"
    )
    ignore: tuple[Name, ...] = Field((), description="causes that the diagnosis does not search for")
    judge_on: Path | None = Field(
        None,
        description="folder of a second campaign of the same machine, relative to campaign.toml: the models that are "
        "fitted here predict it, and their errors are listed",
    )

    @model_validator(mode="after")
    def _is_applied_or_ignored(self) -> Diagnosis:
        if both := sorted({*self.apply} & {*self.ignore}):
            raise ValueError(
                f"{', '.join(both)} in apply or in ignore, not in both: a cause that is ignored is never found"
            )
        return self


class SetLimits(Section):
    """[qa.limits.<check>]: from where on a check warns or fails, in place of its declared limits."""

    warn: NotNegative | None = Field(None, description="from where on the check warns; absent: as declared")
    fail: NotNegative | None = Field(None, description="from where on it fails; absent: as declared")
    reason: Words | None = Field(None, description="why; the check says it with its verdict")


class QualityLimits(Section):
    """[qa]: the probability that all failing checks together trip on a good campaign, and limits of its own."""

    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.01, description="probability that any check fails on a good campaign"
    )
    limits: dict[str, SetLimits] = Field(default_factory=dict, description="by check, where its limits are plain")


class Overrule(Section):
    """[[exclude]], [[keep]]: a point or a reading left out or kept by a person, by name and with a reason.

    An absent key stands for all: ``body = "platform", target = "P07"`` concerns that target in every pose, ``run = 3,
    channel = "dz"`` that channel in every step of the run.
    """

    pose: Identifier | None = Field(None, description="the pose")
    body: Name | None = Field(None, description="the body")
    target: Name | None = Field(None, description="the target")
    run: Identifier | None = Field(None, description="interferometer: the run")
    step: int | None = Field(None, description="interferometer: the load step within its run")
    channel: Literal["dx", "dy", "dz", "rx", "ry", "rz", "v1", "v2", "v3", "v4", "v5", "v6", "v7", "v8"] | None = Field(
        None, description="interferometer: what was read"
    )
    by: Name = Field(description="who decided")
    on: Day | None = Field(None, description="when, as 2026-11-22")
    reason: Words = Field(description="why")

    @property
    def signed(self) -> str:
        """Who decided, and when."""
        return self.by if self.on is None else f"{self.by} on {self.on}"


class Acceptance(Section):
    """[[accept]]: a QA verdict accepted by a person, by name and with a reason."""

    check: Name = Field(description="the check, as qa.parquet names it")
    subject: Name | None = Field(None, description="what it concerns; absent: whatever it concerns")
    by: Name = Field(description="who decided")
    on: Day | None = Field(None, description="when, as 2026-11-22")
    reason: Words = Field(description="why")

    @property
    def signed(self) -> str:
        """Who decided, and when."""
        return self.by if self.on is None else f"{self.by} on {self.on}"


class Renamed(Section):
    """[[renamed]]: a target that the files call otherwise in some poses; ``target`` is its name in the campaign.

    ``from_pose`` and ``to_pose`` count in the order of time and are both within; an absent one means the first or the
    last. All entries act at once, so two targets may take each other's names.
    """

    body: Name = Field(description="the body that carries it")
    called: Name = Field(description="what the files call it")
    target: Name = Field(description="which target it is")
    from_pose: Identifier | None = Field(None, description="the first pose of it; absent: the first of all")
    to_pose: Identifier | None = Field(None, description="the last pose of it; absent: the last of all")
    by: Name | None = Field(None, description="who says so")
    reason: Words | None = Field(None, description="why")


class Resurvey(Section):
    """[[resurvey]]: from which pose on a later survey of ``resurveys`` holds; one without this table is a check alone.

    A target that lies elsewhere in it is another one from that pose on: ``P07@after``, for a survey called after.
    """

    survey: Name = Field(description="its name in the column survey of the table resurveys")
    from_pose: Identifier | None = Field(None, description="the first pose that it holds for; absent: a check alone")
    moved: tuple[Name, ...] = Field((), description="targets known to have been moved, however little")
    by: Name | None = Field(None, description="who says so")
    reason: Words | None = Field(None, description="why")
