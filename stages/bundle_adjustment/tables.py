"""Tables of the adjusted network: points with covariance, cameras, images, residuals, scale bars, known points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask, TableRow
from truing.estimation.bundle.camera import PARAMETERS, UNITS
from truing.estimation.bundle.determinable import UndeterminedNetworkError
from truing.estimation.bundle.known_points import KnownPointErrors, KnownTested
from truing.estimation.bundle.named_adjustment import AdjustedNetwork, KnownPointMismatchError
from truing.estimation.bundle.network import ImagePoints, NamedNetwork
from truing.estimation.bundle.network_statistics import intersections
from truing.estimation.rotation import log_so3
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.stages.bundle_adjustment.paired_points import paired_points
from truing.stages.bundle_adjustment.rays_as_network import bar_ends

_COVARIANCE = [(i, j) for i in range(6) for j in range(i, 6)]
_AXES = "xyz"
WRONG = "contradicts the rays"
NO_RAY = "none of its rays is left"
UNRESOLVED = "contradicts the rays or other known points; which is wrong is undetermined"


class NetworkTables:
    """Tables of one adjusted network; covariances are scaled by the residuals."""

    def __init__(self, adjusted: AdjustedNetwork, table: ImagePoints, surveyed: frozenset[str] = frozenset()) -> None:
        """surveyed: names of points whose correlations are wanted first in large poses."""
        self.found, self.table = adjusted, table
        self.adjusted, self.named, self.network = adjusted.adjustment, adjusted.named, adjusted.named.network
        factor = adjusted.screened.covariance_factor
        self.factor = float(factor) if np.isfinite(factor) else 1.0
        self.covariance = self.adjusted.covariance
        self.camera_names = np.array([camera.name for camera in self.network.cameras], dtype=object)
        self.poses = [p for p in range(len(self.named.poses)) if len(self.covariance.point_numbers(p))]
        numbers = {pose: self.covariance.point_numbers(pose) for pose in self.poses}
        self.paired = paired_points(self.named, numbers, self.adjusted.state.points, surveyed)
        self.common = self.covariance.common * self.factor
        self.common_sigma = np.sqrt(np.diagonal(self.common))
        self.parameters = tuple(self._parameter(*name) for name in self.covariance.names)

    def _parameter(self, owner: str, element: str | int) -> str:
        return (
            f"bar {self.named.bars[int(element)]}"
            if owner == "bar" and not isinstance(element, str)
            else f"{owner} {element}"
        )

    def all(self, bars: pa.Table | None) -> dict[str, pa.Table]:
        """All tables by artifact name."""
        tables = {
            "object_points": self.object_points(),
            "point_correlations": self.point_correlations(),
            "point_sensitivities": self.point_sensitivities(),
            "cameras": self.cameras(),
            "camera_correlations": self.camera_correlations(),
            "image_orientations": self.image_orientations(),
            "image_residuals": self.image_residuals(),
        }
        return tables | ({} if bars is None else {"scale_bar_lengths": self.scale_bar_lengths(bars)})

    def _pose(self, poses: Index) -> NDArray[np.object_]:
        return np.array([*self.named.poses, None], dtype=object)[:-1][poses]

    def object_points(self) -> pa.Table:
        """A row per adjusted point."""
        numbers = np.concatenate([np.zeros(0, np.int64), *(self.covariance.point_numbers(p) for p in self.poses)])
        blocks = self.covariance.point_blocks()[numbers] * self.factor
        sigma, correlation = _sigma_and_correlation(blocks)
        met = intersections(self.network, self.adjusted.state, self.adjusted.used)
        count = len(self.network.point_pose)
        square = self._squares(self.network.rays.point, count)
        return _table(
            "object_points",
            {
                "pose": self._pose(self.network.point_pose[numbers]),
                "point": self.named.points[numbers],
                "body": self.named.bodies[numbers],
                "target": self.named.targets[numbers],
                **{f"{a}_mm": 1e3 * self.adjusted.state.points[numbers, k] for k, a in enumerate(_AXES)},
                **{f"sigma_{a}_mm": 1e3 * sigma[:, k] for k, a in enumerate(_AXES)},
                "corr_xy": correlation[:, 0, 1],
                "corr_xz": correlation[:, 0, 2],
                "corr_yz": correlation[:, 1, 2],
                "rays": met.rays[numbers],
                "largest_angle_deg": np.degrees(met.largest_angle[numbers]),
                "rms_px": square[numbers],
            },
            self.named,
        )

    def _squares(self, index: Index, count: int) -> Array:
        """Root mean square residual per coordinate for each group of rays, NaN for none."""
        used = self.adjusted.used
        square = np.sum(self.adjusted.residuals_px[used] ** 2, axis=1)
        total = np.bincount(index[used], square, minlength=count)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(total / (2 * np.bincount(index[used], minlength=count))))

    def point_correlations(self) -> pa.Table:
        """A row per pair of points of a pose; in a large pose, pairs of chosen points only."""
        parts: list[TableRow] = []
        for pose in self.poses:
            numbers = self.paired[pose]
            cov = self.covariance.joint(pose, numbers)
            blocks = _sigma_and_correlation(cov)[1].reshape(len(numbers), 3, len(numbers), 3)
            first, second = np.triu_indices(len(numbers), 1)
            pairs = {
                f"corr_{a}_{b}": blocks[first, i, second, j] for i, a in enumerate(_AXES) for j, b in enumerate(_AXES)
            }
            names = self.named.points[self.covariance.point_numbers(pose)[numbers]]
            pose_column = self._pose(np.full(len(first), pose))
            parts.append({"pose": pose_column, "point": names[first], "other_point": names[second], **pairs})
        return _joined_table("point_correlations", parts, self.named)

    def unpaired(self) -> list[str]:
        """Message for each large pose whose pairs are written of some points only."""
        return [
            f"correlations of {len(self.covariance.point_numbers(pose)) - len(pairs):,} of "
            f"{len(self.covariance.point_numbers(pose)):,} points of pose {self.named.poses[pose]} with others"
            for pose, pairs in self.paired.items()
            if len(pairs) < len(self.covariance.point_numbers(pose))
        ]

    def point_sensitivities(self) -> pa.Table:
        """One row per point and common parameter: effect of one standard deviation."""
        parts: list[TableRow] = []
        for pose in self.poses:
            numbers = self.covariance.point_numbers(pose)
            effect = 1e3 * self.covariance.sensitivities(pose) * self.common_sigma
            effect = effect.reshape(len(numbers), 3, -1)
            point, parameter = np.divmod(np.arange(len(numbers) * len(self.parameters)), max(len(self.parameters), 1))
            parts.append(
                {
                    "pose": self._pose(np.full(len(point), pose)),
                    "point": self.named.points[numbers][point],
                    "parameter": np.array(self.parameters, dtype=object)[parameter],
                    **{f"effect_{a}_mm": effect[point, k, parameter] for k, a in enumerate(_AXES)},
                }
            )
        return _joined_table("point_sensitivities", parts, self.named)

    def cameras(self) -> pa.Table:
        """One row per camera and parameter, without sigma if fixed."""
        sigma = dict(zip(self.covariance.names, self.common_sigma, strict=True))
        rows = []
        for number, camera in enumerate(self.network.cameras):
            about = {
                "width_px": camera.width_px,
                "height_px": camera.height_px,
                "balancing_radius_px": camera.balancing_radius_px,
                "pixel_um": None if camera.pitch_m is None else 1e6 * camera.pitch_m,
            }
            for k, (parameter, unit) in enumerate(zip(PARAMETERS, UNITS, strict=True)):
                known = sigma.get((camera.name, parameter))
                rows.append(
                    {
                        "camera": camera.name,
                        "parameter": parameter,
                        "unit": unit,
                        "value": float(self.adjusted.state.interior[number, k]),
                        "sigma": None if known is None else float(known),
                        "free": known is not None,
                        **about,
                    }
                )
        return table_of_rows("cameras", rows, self.named)

    def camera_correlations(self) -> pa.Table:
        """One row per pair of common parameters."""
        first, second = np.triu_indices(len(self.parameters), 1)
        correlation = np.clip(self.common / self.common_sigma[:, None] / self.common_sigma, -1.0, 1.0)
        names = np.array(self.parameters, dtype=object)
        columns = {"parameter": names[first], "other_parameter": names[second]}
        return _table("camera_correlations", {**columns, "correlation": correlation[first, second]}, self.named)

    def image_orientations(self) -> pa.Table:
        """A row per oriented image."""
        numbers = np.concatenate([np.zeros(0, np.int64), *(self.covariance.image_numbers(p) for p in self.poses)])
        none = np.zeros((0, 6, 6))
        cov = np.concatenate([none, *(self.covariance.images(p) for p in self.poses)]) * self.factor
        state, used = self.adjusted.state, self.adjusted.used
        count = len(self.network.image_pose)
        vector = log_so3(state.R[numbers])
        return _table(
            "image_orientations",
            {
                "pose": self._pose(self.network.image_pose[numbers]),
                "image": self.named.images[numbers],
                "camera": self.camera_names[self.network.image_camera[numbers]],
                **{f"p{a}_mm": 1e3 * state.centre[numbers, k] for k, a in enumerate(_AXES)},
                **{f"r{a}_rad": vector[:, k] for k, a in enumerate(_AXES)},
                **{f"cov_{i}_{j}": cov[:, i, j] for i, j in _COVARIANCE},
                "rays": np.bincount(self.network.rays.image[used], minlength=count)[numbers],
                "rms_px": self._squares(self.network.rays.image, count)[numbers],
                "status": np.full(len(numbers), "ok", dtype=object),
            },
            self.named,
        )

    def image_residuals(self) -> pa.Table:
        """One row per ray, rejected rays and circles without a point included."""
        rays, named, snooped = self.network.rays, self.named, self.found.screened
        rejected = snooped.rejected
        reason = np.full(rays.count, None, dtype=object)
        reason[rejected.ray] = rejected.reason
        sigma = np.sqrt(np.einsum("nii->ni", rays.cov_px2) * snooped.components.ray_factors()[:, None])
        tests, v = snooped.tests, self.adjusted.residuals_px
        with np.errstate(invalid="ignore"):
            w = np.max(np.abs(tests.w), axis=1)
        redundancy = np.clip(tests.redundancy, 0.0, 1.0)
        lost, table = self.found.unmatched, self.table
        image, nothing = np.concatenate([rays.image, table.image[lost]]), np.full(len(lost), np.nan)
        stated = np.sqrt(np.einsum("nii->ni", table.cov_px2[lost]))
        both: dict[str, object] = {
            "pose": self._pose(np.concatenate([self.network.image_pose[rays.image], table.pose[lost]])),
            "image": named.images[image],
            "camera": self.camera_names[self.network.image_camera[image]],
            "point": np.concatenate([named.points[rays.point], table.point[lost]]),
            "kind": np.array(named.kinds, dtype=object)[np.concatenate([rays.kind, table.kind[lost]])],
            **_paired("{}_px", table.xy_px[np.concatenate([named.row, lost])]),
            **_paired("v{}_px", np.concatenate([v, np.full((len(lost), 2), np.nan)])),
            **_paired("sigma_{}_px", np.concatenate([sigma, stated])),
            **_paired("redundancy_{}", np.concatenate([redundancy, np.full((len(lost), 2), np.nan)])),
            "test_value": np.concatenate([w, nothing]),
            **_paired("eccentricity_{}_px", np.concatenate([self.found.eccentricity_px, np.zeros((len(lost), 2))])),
            "rejected": np.concatenate([~self.adjusted.used, np.ones(len(lost), bool)]),
            "reason": np.concatenate([reason, self.found.unmatched_reason]),
        }
        return _table("image_residuals", both, self.named)

    def scale_bar_lengths(self, bars: pa.Table) -> pa.Table:
        """One row per bar and pose with its adjusted length."""
        numbers = np.concatenate([np.zeros(0, np.int64), *map(self.covariance.point_numbers, self.poses)]).tolist()
        keys = {(int(self.network.point_pose[n]), str(self.named.points[n])): n for n in numbers}
        rows = []
        bar_rows = bars.to_pylist()
        for row, pose, first, second in bar_ends(bars, self.named.poses, keys):
            length, sigma = self._distance(pose, first, second)
            reported = {key: bar_rows[row][key] for key in ARTIFACTS["scale_bars"].columns}
            alone = np.hypot(reported["sigma_mm"], reported["repeat_sigma_mm"])
            deviation_sigma = self._deviation_sigma(reported, sigma, alone)
            rows.append(
                {"pose": self.named.poses[pose], **reported, "adjusted_mm": length, "adjusted_sigma_mm": sigma}
                | {"deviation_mm": length - reported["length_mm"], "deviation_sigma_mm": deviation_sigma}
            )
        return table_of_rows("scale_bar_lengths", rows, self.named)

    def _deviation_sigma(self, reported: dict[str, object], sigma_mm: float, alone_mm: float) -> float:
        """Sigma of adjusted minus calibrated length: root sum of squares for a checking bar; root difference of squares
        for a bar in the adjustment, whose adjusted length includes the calibrated one."""
        if reported["serves"] == "check":
            return float(np.hypot(sigma_mm, alone_mm))
        return float(np.sqrt(max(alone_mm**2 - sigma_mm**2, 0.0)))

    def _distance(self, pose: int, first: int, second: int) -> tuple[float, float]:
        """Distance of two points of a pose with its standard deviation, mm."""
        numbers = self.covariance.point_numbers(pose)
        index = np.array([int(np.flatnonzero(numbers == point)[0]) for point in (first, second)])
        cov = self.covariance.joint(pose, index) * self.factor
        difference = self.adjusted.state.points[second] - self.adjusted.state.points[first]
        length = float(np.linalg.norm(difference))
        along = np.concatenate([-difference, difference]) / length
        return 1e3 * length, 1e3 * max(float(along @ cov @ along), 0.0) ** 0.5


def _sigma_and_correlation(cov: Array) -> tuple[Array, Array]:
    """Standard deviations (..., n) and correlations (..., n, n); both zero for coordinates fixed by a minimal datum."""
    variance = np.diagonal(cov, axis1=-2, axis2=-1)
    largest = variance.max(axis=-1, initial=0.0)[..., None]
    sigma = np.sqrt(np.where(variance > 1e-14 * largest, variance, 0.0))
    size = np.where(sigma > 0.0, sigma, np.inf)
    return sigma, np.clip(cov / size[..., :, None] / size[..., None, :], -1.0, 1.0)


def _paired(name: str, values: Array) -> dict[str, Array]:
    return {name.format(a): values[:, k] for k, a in enumerate("xy")}


def table_of_rows(name: str, rows: Sequence[TableRow], named: NamedNetwork) -> pa.Table:
    """The rows as an artifact of a network."""
    return pa.Table.from_pylist(list(rows), schema=ARTIFACTS[name].arrow_schema(_identifier(named)))


def _identifier(named: NamedNetwork) -> str:
    return "string" if any(isinstance(pose, str) for pose in named.poses) else "int64"


def _joined_table(name: str, parts: Sequence[TableRow], named: NamedNetwork) -> pa.Table:
    if not parts:
        return ARTIFACTS[name].empty(_identifier(named))
    return _table(name, {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}, named)


def _table(name: str, columns: dict[str, object], named: NamedNetwork) -> pa.Table:
    """The columns as an artifact, NaN as empty."""
    schema = ARTIFACTS[name].arrow_schema(_identifier(named))
    arrays = [pa.array(columns[key], schema.field(key).type, from_pandas=True) for key in schema.names]
    return pa.table(arrays, schema=schema)


def known_points_table(named: NamedNetwork, tested: KnownTested, used: Mask) -> pa.Table:
    """Table known_point_errors: one row per known point with rays in the initial network."""
    network = named.network
    left = np.bincount(network.rays.point[used[: network.rays.count]], minlength=len(network.point_pose))
    seen = np.bincount(network.rays.point, minlength=len(network.point_pose))
    reported = {
        row: (errors, index)
        for pose, errors in tested.errors.items()
        for index, row in enumerate(tested.rows[pose].tolist())
    }
    rows = []
    for row, point in enumerate(network.known.point.tolist()):
        if not seen[point]:
            continue
        about = _known_point_deviation(*reported[row]) if row in reported else {"rejected": False, "reason": None}
        if not left[point]:
            about |= {"rejected": True, "reason": about["reason"] or NO_RAY}
        pose = named.poses[network.point_pose[point]]
        rows.append({"pose": pose, "point": str(named.points[point]), "rays": int(left[point]), **about})
    return table_of_rows("known_point_errors", rows, named)


def _known_point_deviation(errors: KnownPointErrors, row: int) -> dict[str, object]:
    """Deviation of one known point from the rays, in mm."""
    wrong = bool(errors.wrong[row])
    reason = WRONG if wrong else None if errors.resolved else UNRESOLVED
    if not np.isfinite(errors.p_value[row]):
        return {"rejected": wrong, "reason": reason}
    off = {f"d{axis}_mm": 1e3 * float(value) for axis, value in zip("xyz", errors.off_m[row], strict=True)}
    known = np.isfinite(errors.T[row])
    spread = [1e3 * float(value) if known else None for value in errors.sigma_m[row]]
    sigma = {f"sigma_{axis}_mm": value for axis, value in zip("xyz", spread, strict=True)}
    return {**off, **sigma, "p_value": float(errors.p_value[row]), "rejected": wrong, "reason": reason}


def undetermined(error: UndeterminedNetworkError, rays: int, named: int) -> Fault:
    """Fault of rays that form no network, with the number of named ones."""
    expected = "rays that make a network: images that see points in common, from different sides"
    if named:
        return Fault("image_points", expected, value=str(error))
    # circles are matched along lines of sight of images oriented by codes
    expected = f"targets with a code or a name, four in common to neighbouring images; none of {rays:,} rays has one"
    return Fault("image_points", expected, column="point")


def faults_of(error: KnownPointMismatchError) -> list[Fault]:
    """One fault per pose whose known points belong to another object."""
    return [
        Fault(
            "known_points",
            f"coordinates of points as the rays of pose {pose.pose} show them: is their frame, unit or name another?",
            column="x_mm, y_mm, z_mm",
            value=f"{pose.elsewhere} of {pose.known} elsewhere, {pose.furthest} by {1e3 * pose.off_m:.3g} mm",
        )
        for pose in error.poses
    ]
