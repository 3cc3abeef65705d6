"""Chosen poses of a chain and their detectable effects, in tables and words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.calibration.chain_design import ChosenChainPoses, HiddenCombination, Remedy, UnknownKind
from truing.estimation.design.pose_order import PoseOrder
from truing.report.numbers import count_text
from truing.report.wordings.catalogue import cause_words
from truing.stages.common.chain_candidates import Forbids, JointRanges
from truing.stages.configurations.chosen import DesignOptions
from truing.stages.configurations.order_sentences import order_sentences, percent_of

# Two causes look alike if an effect of plausible size differs by fewer sigma from the best effect of the other.
SEPARATION_SIGMAS = 5.0
_LISTED = 5  # combinations and pairs of causes in words; the tables hold all
_KINDS = {
    UnknownKind.OFFSET: "zeros of joints",
    UnknownKind.LINK: "numbers of links",
    UnknownKind.TARGET: "places of targets and tools",
    UnknownKind.BASE: "numbers of the base's place",
    UnknownKind.CAUSE: "parameters of causes",
}
_SEPARATED = {
    Remedy.POSES: "as many poses spread over the ranges of the joints separate them",
    Remedy.PAYLOAD: "poses with another payload separate them",
    Remedy.NOTHING: "no poses within the ranges separate them, with any payload",
}


@dataclass(frozen=True)
class ChainDesignTables:
    """Tables of the campaign, measured or planned, and those named in the call; ``functions`` forbid poses."""

    campaign: Mapping[str, pa.Table]
    extend: pa.Table | None = None
    extend_file: str = "--extend"
    avoid: pa.Table | None = None
    avoid_file: str = "--avoid"
    functions: tuple[Forbids, ...] = ()


@dataclass(frozen=True)
class ShownByPoses:
    """Information of some poses: the table of unknowns, that of causes, and hidden combinations with the readings (T,
    n) of poses that would show them."""

    count: int
    numbers: pa.Table
    causes: pa.Table
    hidden: tuple[tuple[HiddenCombination, pa.Table], ...]


@dataclass(frozen=True)
class ChainDesign:
    """Chosen poses of a chain and their quality; ``existing``: efficiency of the campaign's own poses."""

    options: DesignOptions
    table: pa.Table
    ranges: JointRanges
    forbidden: int
    candidates: int
    chosen: ChosenChainPoses
    kept: int
    order: PoseOrder
    existing: float | None
    own: ShownByPoses | None
    plan: ShownByPoses
    causes: tuple[str, ...]


def words_of_chain(design: ChainDesign) -> list[str]:
    """Output lines of a design of a chain."""
    return [
        *_chosen(design),
        *_order(design),
        *(_shown("the campaign's own", design.own) if design.own is not None else ()),
        *_shown("the chosen" if not design.kept else "the kept and chosen", design.plan),
    ]


def _chosen(design: ChainDesign) -> list[str]:
    options, chosen_poses = design.options, design.chosen
    held_out_words = f" and {options.verification} for verification" if options.verification else ""
    kept_words = f" next to {design.kept} that are kept" if design.kept else ""
    sources = ", ".join(dict.fromkeys(design.ranges.given_by))
    regions = f", outside {count_text(design.forbidden, 'forbidden region')}" if design.forbidden else ""
    of_causes = f", with the effects of {', '.join(design.causes)}" if design.causes else ""
    lines = [
        f"{count_text(options.poses, 'pose')}{held_out_words} by {options.method}{kept_words}, "
        f"within the ranges of the joints ({sources}){regions}",
        f"log det of the information, relative to what is known before: {chosen_poses.log_det:.3f} "
        f"({count_text(chosen_poses.size, 'unknown')}{of_causes})",
        f"D-efficiency {percent_of(chosen_poses.efficiency)} of the best possible (equivalence theorem over "
        f"{count_text(design.candidates, 'candidate')}; poses between them are not covered)",
    ]
    if design.existing is not None and design.own is not None:
        share = percent_of(design.existing)
        lines.append(f"the campaign's own {count_text(design.own.count, 'pose')}: {share} of the best of as many")
    return lines


def _order(design: ChainDesign) -> list[str]:
    imitating = "a reading with its sine and cosine"
    return order_sentences(design.order, 1.0, "full ranges of a joint", "the joint that moves most", imitating)


def _shown(whose: str, shown: ShownByPoses) -> list[str]:
    numbers = shown.numbers.to_pylist()
    parts = []
    for kind, words in _KINDS.items():
        rows_of_kind = [row["identifiable"] for row in numbers if row["kind"] == kind]
        if rows_of_kind:
            parts.append(f"{sum(rows_of_kind)} of {len(rows_of_kind)} {words}")
    lines = [f"{whose} {count_text(shown.count, 'pose')} determine {', '.join(parts)}"]
    lines += [_hidden(combination, poses) for combination, poses in shown.hidden[:_LISTED]]
    if (more := len(shown.hidden) - _LISTED) > 0:
        lines.append(f"  {count_text(more, 'further combination')} that the data leave less certain than before")
    return lines + _causes(shown.causes.to_pylist())


def _hidden(combination: HiddenCombination, poses: pa.Table) -> str:
    size = (
        "" if not np.isfinite(combination.sigma) else f" (known to {combination.sigma:.2g} times what is known before)"
    )
    return f"  {combination.text}{size}: {_shown_by(combination, poses)}"


def _shown_by(combination: HiddenCombination, poses: pa.Table) -> str:
    if combination.remedy is Remedy.POSES:
        return f"shown by {'; '.join(_pose(row) for row in poses.to_pylist())}"
    if combination.remedy is Remedy.NOTHING:
        return "no pose within the ranges shows it"
    return f"no pose within the ranges shows it; {combination.remedy} would"


def _pose(row: TableRow) -> str:
    times = row["times"]
    often = f" {times} times" if times > 1 else ""
    return " ".join(f"{name} {value:g}" for name, value in row.items() if name != "times") + often


def _causes(rows: Sequence[TableRow]) -> list[str]:
    if not rows:
        return []
    hidden = [row for row in rows if row["sigma_expected"] is None or row["sigma_expected"] > row["plausible"]]
    named = list(dict.fromkeys(_called(row) for row in hidden))
    lines = [
        f"  effects of causes: {len(rows) - len(hidden)} of {len(rows)} parameters known to better than a plausible "
        "size"
    ]
    if named:
        lines[-1] += f"; not of {', '.join(named[:_LISTED])}{', ...' if len(named) > _LISTED else ''}"
    pairs = {frozenset((_called(row), _other(row))): row for row in rows if row["separated_by"] is not None}
    ranked = sorted(pairs.values(), key=lambda row: row["apart"])
    for row in ranked[:_LISTED]:
        lines.append(
            f"  {_called(row)} and {_other(row)} look alike ({row['apart']:.1f} of {row['signal']:.0f} sigma): "
            f"{_SEPARATED[Remedy(row['separated_by'])]}"
        )
    if (more := len(ranked) - _LISTED) > 0:
        lines.append(f"  {count_text(more, 'further pair')} of causes that look alike")
    return lines


def _called(row: TableRow) -> str:
    return _name(row["cause"], row["subject"], row["order"])


def _other(row: TableRow) -> str:
    return _name(row["most_like"], row["most_like_subject"], row["most_like_order"])


def _name(cause: str, subject: str, order: float | None) -> str:
    of_order = f" of order {order:g}" if order else ""
    return f"{cause_words(cause)}{of_order}{f' ({subject})' if subject else ''}"
