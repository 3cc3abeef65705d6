"""Object points from photographs as points of a campaign: body and uncertainty of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.covariance import in_inner_constraints
from truing.formats.dictionaries import strings
from truing.formats.evaluation import TableBatch
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import COORDINATE_SIGMAS, COORDINATES
from truing.formats.read import FileRows
from truing.formats.source import RawFile
from truing.report.numbers import count_text
from truing.schemas.faults import Fault
from truing.schemas.mapping import FileMapping
from truing.stages.common.point_arrays import number_column, points_and_cov, pose_ids, positions
from truing.stages.common.point_errors import point_errors

if TYPE_CHECKING:
    from pathlib import Path

    from truing.formats.colmap import ColmapNetwork

FILE = "object_points.parquet"
ONE_BODY = "object"
"""Default name of the body if neither targets nor a survey name one."""
OF_NO_BODY = "points of no body: ends of scale bars, or targets that no survey has"
Names = NDArray[np.object_]
_PAIRS = (("corr_xy", 0, 1), ("corr_xz", 0, 2), ("corr_yz", 1, 2))
UNPAIRED = "points of large poses whose correlations with others are not written"
# Of another program's network whose covariance is found: points, unless images exceed the second number.
MOST_POINTS, MOST_IMAGES, FEW_POINTS = 50_000, 500, 1500


@dataclass(frozen=True)
class AdjustedPoints:
    """Artifact object_points, endpoints of scale bars, campaign folder, and names of boards; without a survey each
    board is a body. paired (N,): points whose correlations with the others of these are known; None if all."""

    table: pa.Table
    ends: frozenset[str]
    folder: Path
    boards: tuple[str, ...] = ()
    paired: Mask | None = None

    def batches(
        self, surveyed: Mapping[str, Mapping[str, object]], bodies: tuple[str, ...], log: FaultLog
    ) -> Iterator[tuple[FileRows, TableBatch]]:
        """Yield all points with a body as one batch; ``surveyed``: targets by body; ``bodies``: all allowed bodies."""
        body, target = (_texts(self.table, name) for name in ("body", "target"))
        point = _texts(self.table, "point")
        body, of_several = _bodies(body, target, surveyed, self.boards)
        for name in dict.fromkeys(target[of_several].tolist()):
            text = "one body whose survey has this target, or its body in image_targets or image_points"
            log.add(Fault(FILE, text, column="target", value=name))
        ends = np.array([name in self.ends for name in point], dtype=bool)
        foreign = np.array([bool(bodies) and name not in bodies for name in body], dtype=bool)
        unsurveyed = np.array([name not in surveyed for name in body], dtype=bool)
        nobody = (target != "") & ((body == "") | (ends & unsurveyed) | (foreign & unsurveyed))
        paired = np.ones(len(body), bool) if self.paired is None else self.paired
        keep = np.flatnonzero(~nobody & ~of_several & paired)
        left_out = Counter({OF_NO_BODY: int(nobody.sum()), UNPAIRED: int((~nobody & ~paired).sum())})
        left_out = +left_out
        file = FileRows(RawFile(FILE, self.folder / FILE), FileMapping(path=FILE), "parquet")
        yield file, TableBatch(self._columns(keep, body, target, point), keep, left_out=left_out)

    def _columns(self, keep: Index, body: Names, target: Names, point: Names) -> dict[str, pa.Array]:
        names = (*COORDINATES, *COORDINATE_SIGMAS, *(name for name, _, _ in _PAIRS))
        columns = {name: self.table.column(name).combine_chunks().take(keep) for name in names}
        pose = self.table.column("pose").combine_chunks().take(keep)
        columns["pose"] = pose.dictionary_encode() if pa.types.is_string(pose.type) else pose
        texts = {"body": body, "target": target, "point": point}
        return columns | {name: strings(values[keep].tolist()).dictionary_encode() for name, values in texts.items()}

    def as_text(self) -> AdjustedPoints:
        """Return the same points with poses as text, as in configurations with a pose that is no number."""
        column = self.table.column_names.index("pose")
        table = self.table.set_column(column, "pose", self.table.column("pose").cast(pa.string()))
        return replace(self, table=table)


def _texts(table: pa.Table, name: str) -> Names:
    return np.array(table.column(name).to_pylist(), dtype=object)


def _bodies(
    body: Names, target: Names, surveyed: Mapping[str, Mapping[str, object]], boards: tuple[str, ...]
) -> tuple[Names, Mask]:
    """Return the body of each point, by its target's name if not stated, and the names that several bodies share."""
    nameless = (body == "") & (target != "")
    if not surveyed:
        of_board = [name.rpartition("-")[0] for name in target]
        body_of_board = np.array([name if name in boards else ONE_BODY for name in of_board], dtype=object)
        return np.where(nameless, body_of_board, body), np.zeros(len(body), bool)
    points_by_body: dict[str, list[str]] = {}
    for name, targets in surveyed.items():
        for one in targets:
            points_by_body.setdefault(one, []).append(name)
    bodies_of_target = [
        points_by_body.get(one, []) if unknown else [] for one, unknown in zip(target, nameless, strict=True)
    ]
    several = np.array([len(names) > 1 for names in bodies_of_target], dtype=bool)
    single = np.array([names[0] if len(names) == 1 else "" for names in bodies_of_target], dtype=object)
    return np.where(nameless, single, body), several


def paired_points(points: pa.Table, correlations: pa.Table | None) -> Mask:
    """Return the object points (N,) whose correlations with the other such points of their pose are known."""
    errors = point_errors(points, correlations, None)
    return np.ones(points.num_rows, bool) if errors is None else errors.is_paired


def in_inner_datum(points: pa.Table, correlations: pa.Table | None) -> pa.Table:
    """Return object_points with standard deviations and correlations in the inner datum, if coordinates of them are
    held; otherwise unchanged. Of a large pose, that of the points whose correlations are known."""
    sigmas = np.column_stack([number_column(points, name) for name in COORDINATE_SIGMAS]) == 0.0
    errors = point_errors(points, correlations, None) if sigmas.any() else None
    if errors is None:
        return points
    xyz, cov = points_and_cov(points)
    poses = pose_ids(points)
    of_pose = positions(points.column("pose"), poses)
    for pose in range(len(poses)):
        count, rows = int(sigmas[of_pose == pose].sum()), np.flatnonzero((of_pose == pose) & errors.is_paired)
        if count:
            in_datum = in_inner_constraints(xyz[rows], errors.covariance(rows), with_scale=count > 6)
            each = np.arange(len(rows))
            cov[rows] = in_datum.reshape(len(rows), 3, len(rows), 3)[each, :, each, :]
    return _with_covariance(points, cov)


def _with_covariance(points: pa.Table, cov: Array) -> pa.Table:
    sigma = np.sqrt(np.einsum("nii->ni", cov))
    columns = {name: 1e3 * sigma[:, k] for k, name in enumerate(COORDINATE_SIGMAS)}
    columns |= {name: cov[:, i, j] / (sigma[:, i] * sigma[:, j]) for name, i, j in _PAIRS}
    for name, values in columns.items():
        points = points.set_column(points.column_names.index(name), name, pa.array(values, pa.float64()))
    return points


@dataclass
class EstimatedCovariance:
    """Estimated covariances and notes on them. A file that is read twice is adjusted once."""

    remarks: list[str] = field(default_factory=list)
    found: dict[bytes, Array | None] = field(default_factory=dict)

    def __call__(self, network: ColmapNetwork) -> Array | None:
        """Return the covariances (P, 3, 3) of a model's points in its own unit; None if unknown."""
        key = network.points.tobytes() + network.ray_px.tobytes()
        if key not in self.found:
            self.found[key] = self._estimated(network)
        return self.found[key]

    def _estimated(self, network: ColmapNetwork) -> Array | None:
        count = len(network.points)
        images = len(network.image_camera)
        if count > MOST_POINTS or (count > FEW_POINTS and images > MOST_IMAGES):
            limit = f"{MOST_POINTS:,} points" if count > MOST_POINTS else f"{MOST_IMAGES:,} images"
            self.remarks.append(
                f"no standard deviations of {count_text(count, 'point')} without any: more than {limit}"
            )
            return None
        try:
            with np.errstate(all="ignore"):  # whatever a damaged model holds
                covariance, sigma_px = _covariance(network)
        except (ValueError, np.linalg.LinAlgError):
            self.remarks.append(
                f"no standard deviations of {count_text(count, 'point')}: their rays do not determine them"
            )
            return None
        known = int(np.isfinite(covariance[:, 0, 0]).sum())
        self.remarks.append(
            f"standard deviations of {count_text(known, 'point')} estimated from their rays (noise {sigma_px:.2g} px "
            "by their residuals; free datum, without a scale)"
        )
        return covariance


def _covariance(colmap_network: ColmapNetwork) -> tuple[Array, float]:
    """Return covariances (P, 3, 3) and the noise of an image coordinate in px, estimated from the residuals."""
    from truing.estimation.bundle.adjustment import adjust
    from truing.estimation.bundle.camera import PARAMETERS, Camera
    from truing.estimation.bundle.determinable import determinable
    from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays

    rows: list[Any] = colmap_network.cameras
    cameras = tuple(
        Camera(row["camera"], row["width_px"], row["height_px"], 0.0, None, tuple(row["free"].split())) for row in rows
    )
    images, points, rays = len(colmap_network.image_camera), len(colmap_network.points), len(colmap_network.ray_image)
    network = Network(
        cameras,
        colmap_network.image_camera,
        np.zeros(images, np.int64),
        np.zeros(points, np.int64),
        Rays(
            colmap_network.ray_image,
            colmap_network.ray_point,
            colmap_network.ray_px,
            np.broadcast_to(np.eye(2), (rays, 2, 2)),
            np.zeros(rays, np.int64),
        ),
        Bars.none(),
        KnownPoints.none(),
    )
    names = ("focal_px", "x0_px", "y0_px", *PARAMETERS[3:])
    interior = np.array([[row[name] for name in names] for row in rows], dtype=float)
    state = NetworkState(interior, colmap_network.R, colmap_network.centre, colmap_network.points, np.empty(0))
    adjusted = adjust(network, state, "free", used=determinable(network).rays)
    if not adjusted.redundancy > 0:
        raise ValueError(f"found redundancy {adjusted.redundancy}, expected at least 1")
    return adjusted.covariance.point_blocks() * adjusted.variance_factor, float(np.sqrt(adjusted.variance_factor))
