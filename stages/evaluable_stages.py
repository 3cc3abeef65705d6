"""Stages that the tables of a campaign allow, by the conditions of the stages themselves, without a fit."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from truing.report.numbers import count_text
from truing.stages.common.missing_data import (
    HELD_OUT,
    LEAST_POSES,
    LEAST_TARGETS,
    NO_BODY_TO_DIAGNOSE,
    NO_POINTS_TO_DEFORM,
    NO_POINTS_TO_DIAGNOSE,
    why_no_calibration,
    why_no_deformation_of_legs,
    why_no_deformation_of_loads,
    why_no_deformation_of_targets,
    why_no_diagnosis_of_mechanism,
    why_reference_unseen,
    why_too_few_determined,
    why_too_few_of_chain,
    why_too_few_poses,
)
from truing.stages.declaration import registered

if TYPE_CHECKING:
    import numpy as np
    import pyarrow as pa
    from numpy.typing import NDArray

    from truing.schemas.campaign import Campaign

_UNTARGETED = {"measured_poses": "measured poses", "scans": "dense scans"}
_ADJUSTED = "known once the photographs are adjusted"
# What tells the prospects of a mechanism that is neither of legs nor a sensor on its bench, by its type.
_OF_TYPES = {"axis": "truing.stages.common.evaluable_axis_stages"}
_REMAINING = ("pose", "deformation", "diagnose", "calibrate")


@dataclass(frozen=True)
class CampaignContents:
    """Contents of a campaign before evaluation.

    Small tables by artifact; ``targets``: number per body and pose; ``names``: some poses of the targets of each body;
    ``given``: tables of loads and photographs with files; ``is_photographed``: points come from photographs that are
    not measured yet.
    """

    tables: Mapping[str, pa.Table]
    targets: Mapping[str, Mapping[object, int]] = field(default_factory=dict)
    is_photographed: bool = False
    given: frozenset[str] = frozenset()
    names: Mapping[str, Mapping[str, Collection[object]]] = field(default_factory=dict)

    @property
    def is_of_poses(self) -> bool:
        """Return True if poses were measured or surfaces scanned, without targets."""
        return not self.targets and not self.is_photographed and bool(self._untargeted)

    @property
    def _untargeted(self) -> list[str]:
        return [words for name, words in _UNTARGETED.items() if name in self.tables and self.tables[name].num_rows]

    @property
    def of_poses(self) -> str:
        """Return in words the sources of poses besides targets; empty without any."""
        return " and ".join(self._untargeted)

    def determined(self, body: str) -> int:
        """Return the number of poses in which a body has enough targets for its own pose."""
        return sum(count >= LEAST_TARGETS for count in self.targets.get(body, {}).values())


@dataclass(frozen=True)
class Prospect:
    """Expected result of a stage: ``content``, what it will evaluate; ``why_not``: reason why it evaluates nothing,
    otherwise empty; ``perhaps``: condition that the tables alone do not decide."""

    stage: str
    why_not: str
    content: str = ""
    perhaps: str = ""

    def __str__(self) -> str:
        if self.perhaps and not self.why_not:
            return f"{self.stage:<12} perhaps: {self.perhaps}"
        text = f"not evaluated: {self.why_not}" if self.why_not else f"evaluated{self.content and ': '}{self.content}"
        return f"{self.stage:<12} {text}"


def prospects(settings: Campaign, contents: CampaignContents) -> Iterator[Prospect]:
    """Yield the expected evaluation of each measuring stage, for points or loads."""
    if (prospects_of_type := registered(_OF_TYPES, settings)) is not None:
        yield from (Prospect(*reported) for reported in prospects_of_type.prospects(settings, contents.tables))
        return
    if settings.campaign.kind == "interferometer":
        yield from _prospects_of_loads(settings, contents)
        return
    pose = _pose(contents)
    yield pose
    for stage, why_not in (
        ("deformation", _deformation(settings, contents)),
        ("diagnose", _diagnosis(settings, contents)),
        ("calibrate", why_no_calibration(settings.mechanism, contents.tables, contents.targets) or _too_few(contents)),
    ):
        perhaps = _ADJUSTED if stage == "diagnose" and contents.is_photographed else ""
        needs_body = stage == "deformation" or not _needs_no_body(settings, contents)
        yield Prospect(stage, (needs_body and pose.why_not) or why_not, perhaps=perhaps)
    yield from _adjustment(contents)


def _needs_no_body(settings: Campaign, contents: CampaignContents) -> bool:
    """Return True if a chain's diagnosis takes single targets: the frame stands still, or one link alone is seen."""
    return settings.mechanism.type == "chain" and (settings.is_frame_fixed or len(contents.targets) == 1)


def _adjustment(contents: CampaignContents) -> Iterator[Prospect]:
    """Yield the time and memory that the bundle adjustment of measured rays will take."""
    if "image_points" not in contents.tables:
        return
    import pyarrow.compute as pc

    from truing.estimation.bundle.cost import adjustment_cost

    rays = contents.tables["image_points"].select(["pose", "image", "point"])
    rays = rays.filter(pc.not_equal(rays["point"], ""))
    poses = rays["pose"].unique().to_pylist()
    images, points = (_per_pose(rays.group_by(["pose", key]).aggregate([]), poses) for key in ("image", "point"))
    cost = adjustment_cost(images, points, _per_pose(rays, poses))
    size = f"{count_text(images.sum(), 'image')}, {count_text(points.sum(), 'point')}, {count_text(len(rays), 'ray')}"
    yield Prospect(
        "bundle", "", f"{size}: about {_about(cost.seconds)} s of one core and {_about(cost.bytes / 1e9)} GB"
    )


def _per_pose(rows: pa.Table, poses: Sequence[object]) -> NDArray[np.int64]:
    """Return the number of rows (S,) of each pose."""
    import numpy as np

    counts = rows.group_by("pose").aggregate([([], "count_all")])
    of = dict(zip(counts["pose"].to_pylist(), counts["count_all"].to_pylist(), strict=True))
    return np.array([of.get(pose, 0) for pose in poses], np.int64)


def _about(value: float) -> str:
    """Return a positive number to one significant digit, below 0.1 as that."""
    digits = max(value, 0.1)
    return f"{float(f'{digits:.0e}'):,g}"


def _pose(contents: CampaignContents) -> Prospect:
    if contents.is_photographed:
        return Prospect("pose", "", "known once the photographs are adjusted")
    seen = {body: contents.determined(body) for body in contents.targets}
    if not any(seen.values()) and contents.of_poses:
        return Prospect("pose", "", contents.of_poses)
    if not any(seen.values()):
        return Prospect("pose", f"no body shows {LEAST_TARGETS} targets in one pose, which a pose of it needs")
    words = ", ".join(f"{body} in {count} of {len(contents.targets[body])} poses" for body, count in seen.items())
    return Prospect("pose", "", "; ".join(filter(None, (words, contents.of_poses))))


def _deformation(settings: Campaign, contents: CampaignContents) -> str:
    if contents.is_of_poses:
        return NO_POINTS_TO_DEFORM
    if settings.mechanism.is_legged:
        return why_no_deformation_of_legs(contents.tables)
    return why_no_deformation_of_targets(settings.campaign.drives, contents.tables, settings.mechanism.type)


def _diagnosis(settings: Campaign, contents: CampaignContents) -> str:
    if settings.mechanism.type == "chain" and (contents.is_of_poses or _needs_no_body(settings, contents)):
        return why_too_few_of_chain(len(_fitted_poses(contents)))
    if contents.is_of_poses:
        return NO_POINTS_TO_DIAGNOSE
    if settings.mechanism.is_legged:
        why_not = why_no_diagnosis_of_mechanism(settings.mechanism, settings.noise.point_mm, contents.tables)
        return why_not or _too_few(contents)
    return "" if contents.is_photographed else _diagnosis_of_bodies(settings, contents)


def _fitted_poses(contents: CampaignContents) -> set[str]:
    """Return the poses of configurations that show a target, or were measured as poses, and may be fitted."""
    table = contents.tables.get("configurations")
    if table is None:
        return set()
    measured = contents.tables.get("measured_poses")
    seen = {str(pose) for poses in contents.targets.values() for pose in poses}
    seen |= set() if measured is None else set(map(str, measured.column("pose").to_pylist()))
    roles = zip(table.column("pose").to_pylist(), table.column("role").to_pylist(), strict=True)
    return {str(pose) for pose, role in roles if role != HELD_OUT} & seen


def _diagnosis_of_bodies(settings: Campaign, contents: CampaignContents) -> str:
    reference = None if settings.is_frame_fixed else settings.reference_body
    alone = reference in contents.targets and not {"survey", *_UNTARGETED} & contents.tables.keys()
    if alone and (
        why := why_reference_unseen(str(reference), max(contents.targets[str(reference)].values(), default=0))
    ):
        return why
    if not any(contents.determined(body) >= LEAST_POSES for body in contents.targets):
        return NO_BODY_TO_DIAGNOSE
    table = contents.tables.get("configurations")
    roles = (
        () if table is None else zip(table.column("pose").to_pylist(), table.column("role").to_pylist(), strict=True)
    )
    held_out = {str(pose) for pose, role in roles if role == HELD_OUT}
    determined = {str(pose) for target in contents.targets.values() for pose, n in target.items() if n >= LEAST_TARGETS}
    return why_too_few_determined(len(determined - held_out))


def _too_few(contents: CampaignContents) -> str:
    """Return the reason why the poses of the table are too few, before their points are known."""
    table = contents.tables.get("configurations")
    roles = [] if table is None else table.column("role").to_pylist()
    return why_too_few_poses(sum(role != HELD_OUT for role in roles))


def _prospects_of_loads(settings: Campaign, contents: CampaignContents) -> Iterator[Prospect]:
    readings, signals = contents.tables.get("readings"), contents.tables.get("signals")
    none = readings is None or not readings.num_rows
    yield Prospect("pose", "no readings of displacement" if none else "")
    positions = contents.tables.get("positions")
    is_positioned = positions is not None and positions.num_rows > 0
    why_not = "" if is_positioned else why_no_deformation_of_loads(readings)
    yield Prospect("deformation", why_not, "positioning of an axis" if is_positioned else "")
    yield Prospect("diagnose", _diagnosis_of_loads(settings, contents.tables))
    has_signals = signals is not None and signals.num_rows > 0
    if settings.mechanism.type != "6-upur" and not has_signals:
        yield Prospect("calibrate", "the campaign holds no signals")
    else:
        yield Prospect("calibrate", "", "" if has_signals else "G by [mechanism] alone, for there are no signals")


def _diagnosis_of_loads(settings: Campaign, tables: Mapping[str, pa.Table]) -> str:
    from truing.stages.common.approaches import has_only_approaches, why_no_diagnosis_of_approaches

    if has_only_approaches(tables):
        return why_no_diagnosis_of_approaches(tables["positions"])
    if not any(name in tables and tables[name].num_rows for name in ("readings", "signals")):
        return "no readings and no signals"
    from truing.stages.diagnosis.reading_points import why_no_diagnosis_of_readings

    return why_no_diagnosis_of_readings(tables, settings)


def has_repeats(settings: Campaign, contents: CampaignContents) -> bool:
    """Return True if targets were observed at repeated poses, whose repeatability needs no pose of a body."""
    from truing.stages.common.repeats import repeated_poses

    table = contents.tables.get("configurations")
    if settings.campaign.kind == "interferometer" or table is None or not contents.targets:
        return False
    return bool(repeated_poses(table, settings.campaign.drives, settings.noise.actuator_mm)[0])


def nothing_evaluated(found: Sequence[Prospect]) -> bool:
    """Return True if no stage evaluates anything of a campaign."""
    return all(prospect.why_not for prospect in found if prospect.stage in _REMAINING) and bool(found)
