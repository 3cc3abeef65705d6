"""Distances of the survey in place of scale bars: where nothing else gives photographs their scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.artifacts import ARTIFACTS
from stages.point_arrays import number_column
from truing.formats.faultlog import FaultLog
from truing.formats.gather import gather
from truing.formats.shapes import TARGETS
from truing.formats.source import CampaignFiles

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_SIGMA = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")


@dataclass(frozen=True)
class Survey:
    """What campaign.toml says of the survey: whether [files] maps it, its noise, and the body whose shape is trusted
    (None: that of every body)."""

    mapped: bool
    noise_mm: float | None
    reference: str | None

    @classmethod
    def of(cls, settings: Any) -> Survey:
        """As the settings say; a mechanism stands on its base."""
        base = "base" if settings.mechanism.type != "none" else None
        return cls(bool(settings.files.targets), settings.noise.point_mm, settings.bodies.reference or base)


def with_scale(
    tables: Mapping[str, pa.Table], survey: Survey, source: CampaignFiles, *, known: bool
) -> Mapping[str, pa.Table]:
    """The tables with distances between surveyed targets as scale bars, where there are neither bars nor (known) a
    datum of known points; as they are where the survey does not give any either."""
    bars = tables.get("scale_bars")
    given = bars is not None and "scale" in bars.column("serves").to_pylist()
    if given or known or not (survey.mapped or source.entries("targets")):
        return tables
    seen = frozenset(tables["image_points"].column("point").to_pylist()) - {""}
    found = _surveyed(survey, source, seen)
    if not found:
        return tables
    import pyarrow as pa

    own = pa.Table.from_pylist(found, schema=ARTIFACTS["scale_bars"].arrow_schema("int64", tuple(found[0])))
    checks = [] if bars is None else [bars.select(own.column_names).cast(own.schema)]
    return {**tables, "scale_bars": pa.concat_tables([own, *checks])}


def _surveyed(survey: Survey, source: CampaignFiles, seen: frozenset[str]) -> list[dict[str, object]]:
    """Rows of scale_bars: the longest distances of the reference body (of every one where none is) whose ends no other
    shares, so that their errors are independent."""
    found = gather(source, TARGETS, FaultLog())  # what is wrong with the survey is told when it is read for the poses
    if found is None or any(name not in found.table.column_names for name in TARGETS.required):
        return []
    table = found.table
    body, target = (np.array(table.column(name).to_pylist(), dtype=object) for name in ("body", "target"))
    xyz = np.column_stack([number_column(table, f"{axis}_mm") for axis in "xyz"])
    variance = np.column_stack([_variance(table, name, survey.noise_mm) for name in _SIGMA])
    name = np.array([_name(*both, seen) for both in zip(body, target, strict=True)], dtype=object)
    known = (name != "") & np.isfinite(xyz).all(1) & np.isfinite(variance).all(1)
    rows = []
    for one in dict.fromkeys(body[known]) if survey.reference is None else (survey.reference,):
        own = np.flatnonzero(known & (body == one))
        for first, second in _apart(xyz[own]):
            rows.append(_row(name[own], xyz[own], variance[own], first, second))
    return rows


def _variance(table: pa.Table, name: str, declared: float | None) -> Array:
    given = number_column(table, name) if name in table.column_names else np.full(len(table), np.nan)
    found: Array = np.where(np.isnan(given), np.nan if declared is None else declared, given) ** 2
    return np.where(found > 0.0, found, np.nan)


def _name(body: str, target: str, seen: frozenset[str]) -> str:
    """What rays call a surveyed target: with its body, or by the code alone."""
    return next((name for name in (f"{body}/{target}", target) if name in seen), "")


def _apart(xyz: Array) -> list[tuple[int, int]]:
    """Pairs of points (N, 3), the furthest apart first, each point in one pair at most."""
    first, second = np.triu_indices(len(xyz), 1)
    order = np.argsort(-np.linalg.norm(xyz[first] - xyz[second], axis=1), kind="stable")
    pairs: list[tuple[int, int]] = []
    taken: set[int] = set()
    for a, b in zip(first[order].tolist(), second[order].tolist(), strict=True):
        if not taken & {a, b}:
            pairs.append((a, b))
            taken |= {a, b}
    return pairs


def _row(name: NDArray[np.object_], xyz: Array, variance: Array, first: int, second: int) -> dict[str, object]:
    apart = xyz[second] - xyz[first]
    length = float(np.linalg.norm(apart))
    sigma = float(np.sqrt((variance[first] + variance[second]) @ (apart / length) ** 2))
    bar = f"survey, {name[first]} to {name[second]}"
    ends = {"bar": bar, "first": name[first], "second": name[second], "length_mm": length, "sigma_mm": sigma}
    return {**ends, "repeat_sigma_mm": 0.0, "serves": "scale"}
