"""Pages of the studies of a chain by `truing design`: accuracy of its tip, unique numbers, and tolerances."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from truing.report.column_heads import Head
from truing.report.numbers import count_text, percent, plain, sign
from truing.report.page import Listing, PageHead, ReportSection
from truing.report.tables import Row

Frames = Mapping[str, pd.DataFrame]

_NAMES = {**{axis: f"along {axis}" for axis in "xyz"}, **{f"r{axis}": f"about {axis}" for axis in "xyz"}}
_WHOSE = {"own": "the campaign's own {}", "plan": "the plan of {}", "possible": "{} anywhere within the ranges"}
_KINDS = {
    "offset": ("zero of joint", "zeros of joints"),
    "link": ("number of a link", "numbers of links"),
    "target": ("place of a target", "places of targets and tools"),
    "base": ("number of the base", "numbers of the base's place"),
    "cause": ("parameter of a cause", "parameters of causes"),
    "length": ("shifts of the frame of joint", ""),
    "angle": ("rotations of the frame of joint", ""),
    "all": ("all tolerances together", ""),
}
_LISTED = 5
_SHARE = 0.05  # of a variance, from which a tolerance is named


def chain_accuracy_words(frames: Frames) -> list[str]:
    """Return the results in sentences. frames: errors, plan."""
    errors = frames["errors"]
    lines = [_expected(group) for _, group in errors.groupby("poses", sort=False)]
    of_plan = errors[errors["poses"] == "plan"]
    required = of_plan[of_plan["requirement"].notna()]
    if not len(required):
        lines.append("campaign.toml states no [requirement]: with one, this names the fewest poses that reach it.")
    for row in required.itertuples():
        lines.append(f"Requirement {_NAMES[str(row.component)]}: {_needed(row)}{_decided_by(row)}.")
    unseen = errors[~errors["seen"]]
    if len(unseen):
        lines.append(
            "Rotations of the tip do not show: they need measured orientations, or three targets not on a line."
        )
    lines.append(
        "This holds where the model is right: effects that it lacks come on top. `truing power` says which are found."
    )
    return lines


def _poses_text(poses: str, count: int) -> str:
    """Return the poses of a calibration in words: ``the plan of 30 poses``."""
    return _WHOSE[poses].format(count_text(count, "pose"))


def _expected(group: pd.DataFrame) -> str:
    seen = group[group["seen"]]
    sizes = ", ".join(f"{plain(r.error_95)} {sign(str(r.unit))} {_NAMES[str(r.component)]}" for r in seen.itertuples())
    whose = _poses_text(str(group["poses"].iloc[0]), int(group["count"].iloc[0]))
    return f"After a calibration by {whose}, 95 % of the tip's errors over the ranges stay below {sizes}."


def _needed(row: Row) -> str:
    limit, unit = plain(row.requirement), sign(str(row.unit))
    needed, floor = row.poses_needed, row.of_readings_95
    if not row.seen:
        return f"{limit} {unit} cannot be tested, because nothing measured shows this rotation"
    if needed == needed:
        poses = count_text(int(needed), "well-chosen pose")
        return f"{limit} {unit} needs about {poses}; the noise of the readings alone gives {plain(floor)} {unit}"
    return f"no number of poses reaches {limit} {unit}: the noise of the readings alone gives {plain(floor)} {unit}"


def chain_requirement_words(table: pd.DataFrame) -> list[str]:
    """Return a sentence on each requirement: whether a calibration by the campaign's own poses is expected to meet it,
    and the number of held-out poses that decide."""
    lines = []
    for row in table[table["requirement"].notna() & table["seen"]].itertuples():
        sizes = [f"{plain(value)} {sign(str(row.unit))}" for value in (row.error_95, row.requirement)]
        verdict = "met" if row.error_95 <= row.requirement else "not met"
        lines.append(
            f"Requirement {_NAMES[str(row.component)]}: {sizes[0]} expected after a calibration by these "
            f"{count_text(int(row.count), 'pose')}, {sizes[1]} required: {verdict}{_decided_by(row)}."
        )
    return lines


def _decided_by(row: Row) -> str:
    if row.held_out_needed != row.held_out_needed or row.held_out_needed is None:
        return "; no number of held-out poses decides it" if row.seen else ""
    return f"; {count_text(int(row.held_out_needed), 'held-out pose')} decide it"


def chain_accuracy_head(campaign: str, frames: Frames) -> PageHead:
    """Return the head of the page with the main results."""
    return _head(campaign, "accuracy of the tip after a calibration", chain_accuracy_words(frames))


def _head(campaign: str, title: str, words: list[str]) -> PageHead:
    return PageHead(f"{campaign}: {title}", tuple(("", line) for line in words), ())


_ERROR_HEADS = (
    Head("poses", "Poses of the calibration: the campaign's own, or those of the plan."),
    Head("component", "Component of the tip's pose, in the axes of the base."),
    Head("error", "Size below which 95 % of the errors over the ranges of the joints stay."),
    Head("by readings alone", "The same by the noise of the readings in the predicted pose alone."),
    Head("requirement", "Required accuracy by campaign.toml; a dash where there is none."),
    Head("held-out poses", "Number of held-out poses that decide the requirement after this calibration."),
    Head("poses needed", "Approximate least number of well-chosen poses that reach the requirement."),
)


def chain_accuracy_sections(frames: Frames) -> list[ReportSection]:
    """Return the section of expected errors, and that of the plan."""
    errors, plan = frames["errors"], frames["plan"]
    rows = tuple(
        (
            _poses_text(str(r.poses), int(r.count)),
            _NAMES[str(r.component)],
            *(_sized(getattr(r, name), str(r.unit)) for name in ("error_95", "of_readings_95", "requirement")),
            *(_counted(value) for value in (r.held_out_needed, r.poses_needed)),
        )
        for r in errors.itertuples(index=False)
    )
    lead = (
        "By linearised models of the diagnosis, at poses drawn over the ranges; base and tool are fitted as in a run."
    )
    heads = tuple(Head(str(name), "Column of the plan, as in configurations.csv.") for name in plan.columns)
    poses = tuple(tuple(_cell(value) for value in row) for row in plan.itertuples(index=False))
    return [
        ReportSection("errors", "Expected errors of the tip", lead, listings=(Listing(_ERROR_HEADS, rows),)),
        ReportSection(
            "plan",
            "Poses to measure",
            "In the order in which to measure them; the table next to this page holds them all.",
            listings=(Listing(heads, poses, held_by="the -plan table"),),
        ),
    ]


def _counted(value: float | None) -> str:
    return "–" if value is None or value != value else str(int(value))


def _cell(value: object) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)


def _sized(value: float | None, unit: str) -> str:
    return "–" if value is None or value != value else f"{plain(value)} {sign(unit)}"


def chain_uniqueness_words(frames: Frames) -> list[str]:
    """Return the results in sentences. frames: numbers, combinations."""
    lines = [
        "In an open chain, each set of readings has exactly one pose of the tip: there is nothing to prove. "
        "This says which numbers of the chain measurements determine uniquely."
    ]
    combinations = frames["combinations"]
    for poses, group in frames["numbers"].groupby("poses", sort=False):
        parts = ", ".join(f"{r.determined} of {r.unknowns} {_KINDS[str(r.kind)][1]}" for r in group.itertuples())
        whose = _poses_text(str(poses), int(group["count"].iloc[0]))
        lines.append(f"{whose[0].upper()}{whose[1:]} determine {parts}.")
        own = combinations[combinations["poses"] == poses]
        if poses == "own":
            own = own[own["shown_at"].notna()]
            lines += [] if len(own) else ["  They show every combination that poses within the ranges can show."]
        lines += [f"  {_combined(row)}" for row in own.head(_LISTED).itertuples()]
        if len(own) > _LISTED:
            lines.append(f"  {count_text(len(own) - _LISTED, 'further combination')} in the table -combinations")
    return lines


def _combined(row: Row) -> str:
    remedy, shown_at = str(row.remedy), row.shown_at
    if isinstance(shown_at, str) and shown_at:
        return f"{row.combination}: shown by {shown_at}"
    shown = "no pose within the ranges shows it"
    return f"{row.combination}: {shown}" + ("" if remedy == "nothing of these" else f"; {remedy} would")


def chain_uniqueness_head(campaign: str, frames: Frames) -> PageHead:
    """Return the head of the page with the main results."""
    return _head(campaign, "numbers that measurements determine", chain_uniqueness_words(frames))


_UNIQUE_HEADS = (
    Head("poses", "Poses that are evaluated: possible ones over the ranges of the joints, or the campaign's own."),
    Head("combination", "Numbers that change together without a visible effect, with the ratio of their changes."),
    Head("remedy", "What would show the combination."),
    Head("shown at", "Readings of poses that show it, in the units of the columns."),
)


def chain_uniqueness_sections(frames: Frames) -> list[ReportSection]:
    """Return the section of combinations that the data leave uncertain."""
    rows = tuple(
        (str(r.poses), str(r.combination), str(r.remedy), r.shown_at if isinstance(r.shown_at, str) else "–")
        for r in frames["combinations"].itertuples()
    )
    lead = "Combinations of numbers that the data leave less certain than they were before."
    listing = Listing(_UNIQUE_HEADS, rows, held_by="the -combinations table")
    return [ReportSection("combinations", "What stays uncertain", lead, listings=(listing,))]


def chain_tolerance_words(frames: Frames) -> list[str]:
    """Return the results in sentences. frames: errors, and readings if they have noise."""
    errors = frames["errors"]
    whole, sources = errors.iloc[0], errors.iloc[1:]
    lines = [
        "All tolerances together, before a calibration, over the ranges of the joints: rms position error of the tip "
        f"{plain(whole['position_um'])} µm, orientation {plain(whole['orientation_arcsec'])} arcsec."
    ]
    for quantity, unit in (("position", "um"), ("orientation", "arcsec")):
        ranked = sources.sort_values(f"{quantity}_share", ascending=False, kind="stable")
        named = ranked[ranked[f"{quantity}_share"] >= _SHARE].head(_LISTED)
        parts = ", ".join(f"{_source(r)} {percent(100.0 * r[f'{quantity}_share'])}" for _, r in named.iterrows())
        lines.append(f"Shares in the variance of the {quantity}: {parts}.")
        first = ranked.iloc[0]
        total, left = float(whole[f"{quantity}_{unit}"]), 1.0 - 0.75 * float(first[f"{quantity}_share"])
        lines.append(
            f"Half of the first tolerance, {_source(first)}, lowers the rms {quantity} error from {plain(total)} to "
            f"{plain(total * left**0.5)} {sign(unit)}."
        )
    lines.append("A calibration removes most of these errors: `truing design --accuracy` says what it leaves.")
    return lines


def _source(row: pd.Series) -> str:
    return f"{_KINDS[str(row['kind'])][0]} {row['subject']}".strip()


def chain_tolerance_head(campaign: str, frames: Frames) -> PageHead:
    """Return the head of the page with the main results."""
    return _head(campaign, "errors of the tip by tolerances", chain_tolerance_words(frames))


_TOLERANCE_HEADS = (
    Head("tolerance", "Tolerance of [mechanism.tolerance], at one joint or link."),
    Head("position, µm", "Rms error of the tip's position by this tolerance alone, over the ranges of the joints."),
    Head("largest, µm", "The same in the pose where it is largest."),
    Head("share in position", "Share in the variance of the position error by all tolerances."),
    Head("orientation, arcsec", "Rms error of the tip's orientation by this tolerance alone."),
    Head("share in orientation", "Share in the variance of the orientation error by all tolerances."),
)


def chain_tolerance_sections(frames: Frames) -> list[ReportSection]:
    """Return the section of tolerances, and that of the noise of the readings."""
    lead = "One standard deviation of each tolerance, to first order, in the axes of the base, without a calibration."
    sections = [ReportSection("tolerances", "Error by each tolerance", lead, listings=(_tolerances(frames["errors"]),))]
    if "readings" in frames:
        lead = "The same by the noise of the readings in a pose, which no calibration removes."
        listing = _tolerances(frames["readings"].assign(kind="offset"))
        sections.append(ReportSection("readings", "Error by the noise of the readings", lead, listings=(listing,)))
    return sections


def _tolerances(table: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            _source(r),
            plain(r["position_um"]),
            plain(r["position_largest_um"]),
            percent(100.0 * r["position_share"]),
            plain(r["orientation_arcsec"]),
            percent(100.0 * r["orientation_share"]),
        )
        for _, r in table.iterrows()
    )
    return Listing(_TOLERANCE_HEADS, rows)
