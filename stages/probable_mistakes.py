"""Probable mistakes in a campaign, reported by `truing check`."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, cast

from truing.formats.grad_units import is_grad
from truing.formats.raw_tables import CONFIGURATIONS
from truing.report.numbers import listed
from truing.schemas.columns import find_column
from truing.schemas.mapping import RawValue
from truing.schemas.near_names import did_you_mean, is_one_slip_apart, mistyped_name, similar_names
from truing.stages.evaluable_stages import CampaignContents
from truing.stages.ingestion.tables import FITTED

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import AxisMechanism

_GIVE_SCALE = {"scale_bars", "known_points", "image_targets"}
_KEYS_OF_READINGS = {"d": "linear_um", "r": "angular_arcsec"}
_KEYS_OF_MOTION = {"d": "displacement_mm", "r": "rotation_rad"}
_COSTS = "their measured scatter is used instead and is not tested"
_JOINT = re.compile(r"(?:joint\d+|\w+_joint)_(?:rad|deg|mm)")
_SIGNAL = re.compile(r"v\d+_mv")
_READING = re.compile(r"rho\d+_mm")


def attention(settings: Campaign, contents: CampaignContents) -> Iterator[str]:
    """Yield a sentence for each point that a person should check before the run."""
    if settings.campaign.kind == "photogrammetry":
        yield from _remarks_on_frame(settings)
        yield from _remarks_on_poses(contents)
        yield from _remarks_on_bodies(contents)
        yield from _remarks_on_targets(contents)
        yield from _remarks_on_machine(settings, contents)
        yield from _remarks_on_approach(settings, contents)
        yield from _remarks_on_scale(settings, contents)
        yield from _remarks_on_decisions(settings, contents)
    else:
        yield from _remarks_on_noise(settings, contents)
        yield from _remarks_on_signals(contents)
    yield from _remarks_on_grad(settings)
    yield from _remarks_on_names(contents)
    yield from _remarks_on_columns(contents)


def _remarks_on_grad(settings: Campaign) -> Iterator[str]:
    """Raw columns whose unit is called grad, and that no key gives another one."""
    for table, entries in settings.files.items():
        for entry in entries:
            for column, source in entry.columns.items():
                meant = source if isinstance(source, RawValue) else RawValue(name=source)
                is_known = column in entry.units or meant.unit is not None
                if isinstance(meant.name, str) and is_grad(raw := meant.name) and not is_known:
                    yield (
                        f"files.{table}: {raw} is read in degrees. grad is a degree in German, and 1/400 of a turn "
                        f'(gon) elsewhere; units = {{ {column} = "gon" }} or "deg" says which'
                    )


def _remarks_on_signals(contents: CampaignContents) -> Iterator[str]:
    table = contents.tables.get("signals")
    if table is None or not table.num_rows:
        return
    columns = [table.column(name).to_pylist() for name in table.column_names if _SIGNAL.fullmatch(name)]
    count = sum(all(value is None or value != value for value in row) for row in zip(*columns, strict=True))
    if count:
        yield (
            f"{count} of {table.num_rows} load steps have no signal; does a file without signals hold the same loads "
            "as another one?"
        )


def _remarks_on_frame(settings: Campaign) -> Iterator[str]:
    if settings.measurement.frame == "series" and settings.mechanism.type != "chain":  # a chain estimates them
        yield (
            '[measurement] frame = "series": frames of series are not estimated. It is treated like "pose": every '
            "pose in a frame of its own, in which the base has to be seen. The common frame of a series is not used"
        )


def _remarks_on_poses(contents: CampaignContents) -> Iterator[str]:
    configurations = contents.tables.get("configurations")
    if configurations is None or not contents.targets:
        return
    seen = {str(pose) for poses in contents.targets.values() for pose in poses}
    without = [str(pose) for pose in configurations.column("pose").to_pylist() if str(pose) not in seen]
    if "role" in configurations.column_names:
        roles = set(configurations.column("role").to_pylist())
        if roles and FITTED not in roles:
            yield f"no pose has the role {FITTED}; found only {', '.join(sorted(roles))}"
    if without:
        yield f"no point was measured in {_listed('pose', without)} of configurations"


def _remarks_on_bodies(contents: CampaignContents) -> Iterator[str]:
    survey = contents.tables.get("survey")
    if survey is None or not contents.targets:
        return
    surveyed = dict.fromkeys(survey.column("body").to_pylist())
    if without := [body for body in surveyed if body not in contents.targets]:
        yield f"no point was measured of {_listed('surveyed body', without)}"
    if unknown := [body for body in contents.targets if body not in surveyed]:
        near = did_you_mean(unknown[0], surveyed) if len(unknown) == 1 else ""
        yield f"no survey has {_listed('body', unknown)}{near}"


def _remarks_on_targets(contents: CampaignContents) -> Iterator[str]:
    """Targets that are probably others: one letter different from a target missing in these poses, or the only ones in
    place of a target that is missing only there."""
    for body, seen in contents.names.items():
        known = _known_targets(contents, body, seen)
        unknown = [name for name in seen if name not in known]
        for target in unknown:
            meant = [candidate for candidate in known if _may_mean(target, candidate, seen)]
            if not meant and sum(set(seen[name]) == set(seen[target]) for name in unknown) == 1:
                missing_targets = set(contents.targets.get(body, ())) - set(seen[target])
                meant = [candidate for candidate in known if set(seen.get(candidate, ())) == missing_targets]
            if len(meant) == 1:
                where = f"in {_listed('pose', sorted(map(str, seen[target])))}"
                yield f"target {target} of body {body} {where}, where {meant[0]} is missing; did you mean {meant[0]}?"


def _known_targets(contents: CampaignContents, body: str, seen: Mapping[str, Collection[object]]) -> list[str]:
    """Surveyed targets of a body; without a survey those of most of its poses."""
    surveyed = list(map(str, _surveyed(contents, body)))
    return surveyed or [name for name, poses in seen.items() if 2 * len(poses) > len(contents.targets.get(body, ()))]


def _may_mean(target: str, candidate: str, seen: Mapping[str, Collection[object]]) -> bool:
    return is_one_slip_apart(target, candidate) and not set(seen[target]) & set(seen.get(candidate, ()))


def _remarks_on_machine(settings: Campaign, contents: CampaignContents) -> Iterator[str]:
    configurations = contents.tables.get("configurations")
    names = [] if configurations is None else configurations.column_names
    readings = [name for name in names if _READING.fullmatch(name)]
    if readings and not settings.mechanism.is_legged:
        yield (
            f"configurations has the actuators' readings {readings[0]} to {readings[-1]}, and no [mechanism] says of "
            "which machine: nothing is calibrated"
        )
    joints = [name for name in names if _JOINT.fullmatch(name)]
    if len(joints) > 1 and settings.mechanism.type == "none":
        yield (
            f'configurations has joint readings {joints[0]} to {joints[-1]}, and no [mechanism] type = "chain" '
            "describes the arm: joints and links are not diagnosed"
        )


def _remarks_on_approach(settings: Campaign, contents: CampaignContents) -> Iterator[str]:
    """Commands that are repeated where an axis turns, whose direction of approach the rows cannot show."""
    configurations = contents.tables.get("configurations")
    if configurations is None or settings.mechanism.type != "axis":
        return
    command = cast("AxisMechanism", settings.mechanism).command
    if command not in configurations.column_names or "approach" in configurations.column_names:
        return
    commands = configurations.column(command).to_pylist()
    if "time_s" in configurations.column_names:
        times = configurations.column("time_s").to_pylist()
        commands = [at for _, at in sorted(zip(times, commands, strict=True), key=lambda row: row[0] or 0.0)]
    turns = [
        before
        for first, before, after, last in zip(commands, commands[1:], commands[2:], commands[3:], strict=False)
        if None not in (first, before, after, last) and before == after and (before - first) * (last - after) < 0.0
    ]
    if len(turns) > 1:
        yield (
            f"{len(turns)} commands are repeated where the axis turns. They count as approached from the same side as "
            "before; if the axis went beyond and came back, as by ISO 230-2, say so in a column approach (1 or -1)"
        )


def _remarks_on_decisions(settings: Campaign, contents: CampaignContents) -> Iterator[str]:
    """Bodies and targets of [[exclude]] and [[keep]] that were not measured."""
    if not contents.names:
        return
    for key, rules in (("exclude", settings.exclude), ("keep", settings.keep)):
        for number, rule in enumerate(rules, 1):
            if rule.body is not None and rule.body not in contents.names:
                yield f"{key}.{number}: no point is of body {rule.body}{did_you_mean(rule.body, contents.names)}"
                continue
            bodies = contents.names if rule.body is None else (rule.body,)
            targets = dict.fromkeys(target for body in bodies for target in contents.names[body])
            if rule.target is not None and rule.target not in targets:
                yield f"{key}.{number}: no point is called {rule.target}{did_you_mean(rule.target, targets)}"


def _remarks_on_scale(settings: Campaign, contents: CampaignContents) -> Iterator[str]:
    """Photographs without a source of scale, so that all lengths are undetermined."""
    known = settings.photographs
    is_scaled = known.boards or known.marker_mm or contents.given & _GIVE_SCALE or "survey" in contents.tables
    if contents.is_photographed and not is_scaled:
        yield (
            "the photographs have no scale, so the quality check `scale` will fail; give one in scale_bars.csv "
            "(bar,first,second,length_mm,sigma_mm), known_points.csv, targets.csv or [photographs] marker_mm"
        )


def _remarks_on_noise(settings: Campaign, contents: CampaignContents) -> Iterator[str]:
    """Channels without a declared standard deviation; their measured scatter is used and not tested."""
    keys = _KEYS_OF_MOTION if "displacement" in contents.given else _KEYS_OF_READINGS
    measured = (contents.tables.get(name) for name in ("readings", "signals"))
    readings, signals = (table if table is not None and table.num_rows else None for table in measured)
    channels = [] if readings is None else _without_sigma(readings)
    channels_by_key = {key: [channel for channel in channels if channel.startswith(kind)] for kind, key in keys.items()}
    unknown = [f"{' '.join(names)} (noise.{key})" for key, names in channels_by_key.items() if names]
    lost = "nothing is diagnosed"
    if signals is not None and settings.noise.signal_mv is None:
        lost = lost if unknown else "signals are left out of the diagnosis" if readings is not None else ""
        unknown.append("the signals (noise.signal_mv)")
    if unknown:
        yield f"no standard deviation of {' and '.join(unknown)} is declared: {'; '.join(filter(None, (_COSTS, lost)))}"


def _without_sigma(readings: pa.Table) -> list[str]:
    """Channels of readings of which some have no standard deviation."""
    pairs = zip(readings.column("channel").to_pylist(), readings.column("sigma").to_pylist(), strict=True)
    return sorted({channel for channel, sigma in pairs if sigma is None or sigma != sigma})


def _remarks_on_names(contents: CampaignContents) -> Iterator[str]:
    """Names that differ only in spelling, in one table or in two tables that should agree."""
    tables, bodies = (
        contents.tables,
        dict.fromkeys(map(str, [*_column(contents.tables.get("survey"), "body"), *contents.names])),
    )
    poses = dict.fromkeys(pose for seen in contents.targets.values() for pose in seen)
    kinds: dict[str, list[object]] = {
        "poses": [*_column(tables.get("configurations"), "pose"), *poses],
        "bodies": list(bodies),
        "runs": [name for table in ("readings", "signals") for name in _column(tables.get(table), "run")],
    }
    kinds |= {f"targets of body {body}": [*_surveyed(contents, body), *contents.names.get(body, ())] for body in bodies}
    for kind, names in kinds.items():
        for group in similar_names(names):
            yield f"{kind} {' and '.join(group)} are treated as different; did you mean one?"


def _remarks_on_columns(contents: CampaignContents) -> Iterator[str]:
    """Covariates of configurations with nearly the name of a known column that is missing."""
    table = contents.tables.get("configurations")
    names = [] if table is None else table.column_names
    missing = [name for name in CONFIGURATIONS.optional if name not in names]
    for name in names:
        near = None if find_column(name) is not None else mistyped_name(name, missing)
        if near is not None:
            yield f"column {name} of configurations is a quantity of your own; did you mean {near}?"


def _column(table: pa.Table | None, name: str) -> list[object]:
    return [] if table is None else table.column(name).to_pylist()


def _surveyed(contents: CampaignContents, body: object) -> list[object]:
    """Targets of a body in the survey."""
    survey = contents.tables.get("survey")
    pairs = zip(_column(survey, "body"), _column(survey, "target"), strict=True)
    return [target for owner, target in pairs if owner == body]


def _listed(noun: str, names: list[str]) -> str:
    many = {"body": "bodies", "surveyed body": "surveyed bodies"}.get(noun, f"{noun}s")
    return f"{noun if len(names) == 1 else many} {listed(names)}"
