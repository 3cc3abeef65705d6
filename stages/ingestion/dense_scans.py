"""Poses from dense scans: each scan is registered to the reference surface of its body."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, TableRow
from truing.estimation.rotation import log_so3
from truing.estimation.scans.registration import ScanFit, ScanStatus, refine_scan, register_scan
from truing.formats.dictionaries import codes
from truing.formats.evaluation import TableBatch, coordinates
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import SCANS, SURFACES
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault

if TYPE_CHECKING:
    from truing.stages.declaration import Progress


# A pose found from the previous scan is accepted if overlap and fit are similar.
_LESS_OVERLAP, _MORE_RMS = 0.8, 1.25


@dataclass
class DenseScans:
    """Scans of a campaign as rows of the artifact, scanned bodies, and points left out by (subject, reason)."""

    rows: list[TableRow] = field(default_factory=list)
    bodies: set[str] = field(default_factory=set)
    points: int = 0
    left_out: dict[tuple[str, str], int] = field(default_factory=dict)

    def table(self, poses: pa.Array) -> pa.Table:
        """The artifact, its poses of the campaign's type."""
        return pa.Table.from_pylist(self.rows, schema=ARTIFACTS["scans"].arrow_schema(identifier_of(poses)))

    @property
    def read(self) -> str:
        """Description of the scans that were read."""
        return f"{count_text(self.points, 'point')} of {count_text(len(self.rows), 'dense scan')}"

    @property
    def figure(self) -> str:
        """Number of registered scans, and their rms."""
        rms = [row["rms_mm"] for row in self.rows if row["status"] == ScanStatus.OK]
        fit = f", rms {np.sqrt(np.mean(np.square(rms))):.4f} mm" if rms else ""
        return f"{len(rms)} of {len(self.rows)} scans registered{fit}"


def identifier_of(poses: pa.Array) -> str:
    """Type of pose identifiers in artifacts."""
    return "int64" if pa.types.is_int64(poses.type) else "string"


def read_scans(source: CampaignFiles, poses: pa.Array, log: FaultLog, progress: Progress) -> DenseScans | None:
    """Register every scan of the campaign; None without scans. Faults go into ``log``.

    The first scan of a body is searched for globally, with its rivals; a later one near the previous pose first.
    """
    if not source.entries("scans"):
        return None
    scans = DenseScans()
    last: dict[str, ScanFit] = {}
    surfaces = _surfaces(source, log)
    total = len(poses) * max(len(surfaces), 1)
    for file, pose, body, points in _clouds(source, poses, log):
        progress(len(scans.rows), total, f"{body} in pose {pose}")
        scans.bodies.add(body)
        if body not in surfaces:
            known = f"there are {', '.join(surfaces)}" if surfaces else "there is none"
            expected = f"a body with a reference surface in [files.surfaces]; {known}"
            log.add(Fault(file, expected, column="body", value=body))
            continue
        if log:
            continue  # no result is possible: only further faults are collected
        fit = _registered(points, surfaces[body], last.get(body))
        if fit.status == ScanStatus.OK:
            last[body] = fit
        else:
            scans.left_out[(f"pose {pose}, {body}", _refusal(fit))] = fit.n_points
        scans.points += fit.n_points
        scans.rows.append({"pose": pose, "body": body, **_row(fit)})
    return scans


def _surfaces(source: CampaignFiles, log: FaultLog) -> dict[str, Array]:
    """Reference surfaces (M, 3) in m by body."""
    if not source.entries("surfaces"):
        log.add(Fault("surfaces.csv", "reference surfaces of the scanned bodies: [files.surfaces] in campaign.toml"))
    parts: dict[str, list[Array]] = {}
    for _, batch in read_table(source, SURFACES, log):
        column, points = batch.columns["body"], 1e-3 * coordinates(batch)
        for number in np.unique(_numbers(column)).tolist():
            parts.setdefault(column.dictionary[number].as_py(), []).append(points[_numbers(column) == number])
    return {body: np.concatenate(points) for body, points in parts.items()}


def _clouds(source: CampaignFiles, poses: pa.Array, log: FaultLog) -> Iterator[tuple[str, int | str, str, Array]]:
    """Yield file, pose, body and points (N, 3) in m of one scan at a time; scans of unknown poses are faults."""
    known, done = set(poses.to_pylist()), set()
    pending: tuple[str, Any, list[Array]] | None = None
    for file, batch in read_table(source, SCANS, log, poses_as_text=not pa.types.is_int64(poses.type)):
        for key, points in _runs(batch):
            if pending is not None and pending[1] == key:
                pending[2].append(points)
                continue
            if pending is not None:
                yield pending[0], *pending[1], np.concatenate(pending[2])
            pending = None
            if key[0] not in known:
                log.add(Fault(file.raw.name, "a pose of configurations", column="pose", value=str(key[0])))
            elif key in done:
                log.add(Fault(file.raw.name, "one scan per pose and body", value=f"pose {key[0]}, {key[1]}"))
            else:
                pending = (file.raw.name, key, [points])
            done.add(key)
    if pending is not None:
        yield pending[0], *pending[1], np.concatenate(pending[2])


def _runs(batch: TableBatch) -> Iterator[tuple[tuple[int | str, str], Array]]:
    """Yield ranges of successive rows with the same pose and body."""
    if not batch.rows:
        return
    points, (pose, body) = 1e-3 * coordinates(batch), (_numbers(batch.columns[name]) for name in ("pose", "body"))
    starts = np.flatnonzero(np.r_[True, (np.diff(pose) != 0) | (np.diff(body) != 0)])
    for start, end in zip(starts, np.r_[starts[1:], len(points)], strict=True):
        yield tuple(batch.columns[name][int(start)].as_py() for name in ("pose", "body")), points[start:end]


def _numbers(column: pa.Array) -> Index:
    """Return one number per distinct value of a column."""
    return np.asarray(codes(column) if pa.types.is_dictionary(column.type) else column, dtype=np.int64)


def _registered(points: Array, surface: Array, last: ScanFit | None) -> ScanFit:
    if last is not None and last.T_measurement_reference is not None:
        fit = refine_scan(points, surface, last.T_measurement_reference)
        close = fit.overlap >= _LESS_OVERLAP * last.overlap and fit.rms <= _MORE_RMS * last.rms
        if fit.status == ScanStatus.OK and close:
            return fit
    return register_scan(points, surface)


def _refusal(fit: ScanFit) -> str:
    why = "; ".join(fit.unobservable) or (f"{len(fit.rivals)} rivals" if len(fit.rivals) else "")
    return f"scan refused ({fit.status}{': ' + why if why else ''}). {fit.remedy}"


def _row(fit: ScanFit) -> dict[str, object]:
    T, covariance = fit.T_measurement_reference, fit.covariance
    entries = [None] * 6 if T is None else [*(1e3 * T[:3, 3]).tolist(), *log_so3(T[:3, :3]).tolist()]
    return {
        **dict(zip(("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad"), entries, strict=True)),
        **{f"cov_{i}_{j}": None if covariance is None else covariance[i, j] for i in range(6) for j in range(i, 6)},
        "rms_mm": 1e3 * fit.rms,
        "n_used": fit.n_used,
        "n_rejected": fit.n_points - fit.n_used,
        "overlap": fit.overlap,
        "noise_ratio": fit.noise_ratio,
        "status": str(fit.status),
        "message": "registered" if fit.status == ScanStatus.OK else _refusal(fit),
    }
