"""Targets with other names from some pose on: by [[renamed]], and by later surveys."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Index
from truing.formats.dictionaries import as_dictionary, codes
from truing.formats.evaluation import TableBatch
from truing.formats.faultlog import FaultLog
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.near_names import did_you_mean

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_FILE = "campaign.toml"


@dataclass(frozen=True)
class PoseTimes:
    """Poses (B) as text, and the index (B,) of each in the order of time."""

    names: tuple[str, ...]
    place: Index

    @classmethod
    def of(cls, configurations: pa.Table) -> PoseTimes:
        """The order in which the poses of a table were taken."""
        names = tuple(str(pose) for pose in configurations.column("pose").to_pylist())
        time = np.asarray(configurations.column("time_s").to_numpy(zero_copy_only=False), dtype=float)
        rank = np.empty(len(names), np.int64)
        rank[np.argsort(time, kind="stable")] = np.arange(len(names))
        return cls(names, rank)

    def of_pose(self, pose: object) -> int | None:
        """Index of a pose in time; None for an unknown pose."""
        name = str(pose)
        return int(self.place[self.names.index(name)]) if name in self.names else None


@dataclass(frozen=True)
class Relabel:
    """A target of a body with another name from pose index ``first`` to ``last``. ``column``: place in campaign.toml;
    ``why``: person and reason."""

    body: str
    called: str
    target: str
    first: int
    last: int
    column: str
    why: str
    from_pose: str | None = None
    to_pose: str | None = None

    def overlaps(self, other: Relabel) -> bool:
        """Return True if both concern the same body in some pose."""
        return self.body == other.body and self.first <= other.last and other.first <= self.last


@dataclass
class Relabelling:
    """All changes of names, applied together; count: number of points changed by each rule."""

    order: PoseTimes
    rules: tuple[Relabel, ...] = ()
    count: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.count = [0] * len(self.rules)

    def applied(self, batch: TableBatch, pose: NDArray[np.int32]) -> TableBatch:
        """Return the points under their own names; ``pose`` (N,): index of each point's pose, beyond the known poses if
        unknown."""
        rules = [(at, rule) for at, rule in enumerate(self.rules) if _has_target(batch, rule)]
        if not rules:
            return batch
        rank = np.append(self.order.place, -1)[np.minimum(pose, len(self.order.place))]
        body, target = as_dictionary(batch.columns["body"]), as_dictionary(batch.columns["target"])
        bodies, names = body.dictionary.to_pylist(), target.dictionary.to_pylist()
        old, new = codes(target), codes(target).copy()
        for at, rule in rules:
            is_renamed = (codes(body) == bodies.index(rule.body)) & (old == names.index(rule.called))
            is_renamed &= (rank >= rule.first) & (rank <= rule.last)
            if rule.target not in names:
                names.append(rule.target)
            new[is_renamed] = names.index(rule.target)
            self.count[at] += int(is_renamed.sum())
        target = pa.DictionaryArray.from_arrays(pa.array(new, pa.int32()), pa.array(names, pa.string()))
        return replace(batch, columns={**batch.columns, "body": body, "target": target})

    def name_in_files(self, pose: object, body: str, target: str) -> str:
        """Return in words the name of a point in the files; empty if it is the same."""
        rank = self.order.of_pose(pose)
        for rule in self.rules:
            if rank is not None and (rule.body, rule.target) == (body, target) and rule.first <= rank <= rule.last:
                return f"; {rule.called} is {target} there, as {rule.column} has it"
        return ""

    def check(self, log: FaultLog, seen: Sequence[tuple[str, str]]) -> None:
        """Report rules that matched no point; ``is_observed``: body and target of all points."""
        for rule, count in zip(self.rules, self.count, strict=True):
            if not count:
                other_targets = [target for body, target in seen if body == rule.body and target != rule.target]
                text = f"a target that body {rule.body} has under this name in these poses"
                text += did_you_mean(rule.called, other_targets)
                log.add(Fault(_FILE, text, column=f"{rule.column}.called", value=rule.called))


def _has_target(batch: TableBatch, rule: Relabel) -> bool:
    bodies, targets = (as_dictionary(batch.columns[name]).dictionary.to_pylist() for name in ("body", "target"))
    return rule.body in bodies and rule.called in targets


def window(order: PoseTimes, from_pose: object, to_pose: object, column: str, log: FaultLog) -> tuple[int, int] | None:
    """Indices in time of the first and the last pose; None, with a fault, for an unknown pose."""
    first = 0 if from_pose is None else order.of_pose(from_pose)
    last = len(order.names) - 1 if to_pose is None else order.of_pose(to_pose)
    for key, pose, rank in (("from_pose", from_pose, first), ("to_pose", to_pose, last)):
        if rank is None:
            text = f"a pose of the campaign{did_you_mean(str(pose), order.names)}"
            log.add(Fault(_FILE, text, column=f"{column}.{key}", value=str(pose)))
    if first is None or last is None:
        return None
    if first > last:
        text = f"a pose taken no later than to_pose ({to_pose}), in the order of time"
        log.add(Fault(_FILE, text, column=f"{column}.from_pose", value=str(from_pose)))
        return None
    return first, last


def declared_relabelling(settings: Campaign, order: PoseTimes, survey: pa.Table | None, log: FaultLog) -> Relabelling:
    """Return the rules of [[renamed]]; reports contradictions among them, with the survey or with the poses."""
    relabellings = []
    for number, entry in enumerate(settings.renamed, 1):
        column = f"renamed.{number}"
        ranks = window(order, entry.from_pose, entry.to_pose, column, log)
        known = _surveyed(survey, entry.body)
        if known and entry.target not in known:
            text = f"a target of body {entry.body} in the survey{did_you_mean(entry.target, known)}"
            log.add(Fault(_FILE, text, column=f"{column}.target", value=entry.target))
        if entry.target == entry.called:
            log.add(Fault(_FILE, "another name than the target has", column=f"{column}.called", value=entry.called))
        if ranks is not None:
            why = ": ".join(filter(None, (entry.by, entry.reason)))
            poses = (None if pose is None else str(pose) for pose in (entry.from_pose, entry.to_pose))
            relabellings.append(Relabel(entry.body, entry.called, entry.target, *ranks, column, why, *poses))
    for first, other in combinations(relabellings, 2):
        for fault in _contradictions(first, other):
            log.add(fault)
    return Relabelling(order, tuple(relabellings))


def _contradictions(first: Relabel, other: Relabel) -> Iterator[Fault]:
    if not first.overlaps(other):
        return
    if first.called == other.called and first.target != other.target:
        text = f"one target for {first.called} of body {first.body} in one pose; {first.column} says {first.target}"
        yield Fault(_FILE, text, column=f"{other.column}.target", value=other.target)
    elif first.called == other.called:
        text = f"a name once in one pose; {first.column} says the same of {first.called}"
        yield Fault(_FILE, text, column=f"{other.column}.called", value=other.called)
    elif first.target == other.target:
        text = f"one name for {first.target} of body {first.body} in one pose; {first.column} says {first.called}"
        yield Fault(_FILE, text, column=f"{other.column}.called", value=other.called)


def _surveyed(survey: pa.Table | None, body: str) -> list[str]:
    if survey is None:
        return []
    pairs = zip(survey.column("body").to_pylist(), survey.column("target").to_pylist(), strict=True)
    return [target for name, target in pairs if name == body]


def relabelled_table(*parts: Relabelling) -> pa.Table:
    """Return the artifact relabelled: one row per rule, with the number of renamed points."""
    rows = [
        {
            "body": rule.body,
            "called": rule.called,
            "target": rule.target,
            "from_pose": rule.from_pose,
            "to_pose": rule.to_pose,
            "rows": count,
            "reason": rule.why or None,
        }
        for part in parts
        for rule, count in zip(part.rules, part.count, strict=True)
    ]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["relabelled"].arrow_schema())
