"""Another program's bundle adjustment repeated with its rays and settings, and compared with its report.

``python -m tests.real.bundle_answer_key`` writes the tables of docs/bundle-answer-key.md. The report is AICON 3D
Studio's, of a network of 115 images.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew, table
from tests.real.aicon_report import Report, read_report
from tests.real.campaigns import PROJECT, data_folder
from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.camera import PARAMETERS, Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays
from truing.estimation.bundle.start_values import find_start
from truing.estimation.rotation import exp_so3, log_so3
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import CAMERAS, IMAGE_POINTS, SCALE_BARS, RawTable
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles
from truing.schemas.campaign import read_campaign

Array = NDArray[np.float64]

FOLDER = "aicon-bundle"
PAGE = PROJECT / "docs" / "bundle-answer-key.md"
FREE = ("c", "x0", "y0", "A1", "A2", "B1", "B2")  # the report calls the others fixed
_MM = 1e-3
_PRIOR_MM = 0.0005
_FLIP = np.diag([1.0, -1.0, -1.0])  # from a camera with y upwards and z backwards to ours
_LENS_MM = 28.0  # what the lens is called; the report finds 28.785
_FILES = {
    "image_points": {"path": "example.phc.gz", "constants": {"pose": 1}},
    "cameras": {"path": "example.ior"},
    "scale_bars": {"path": "example.scale"},
}


@dataclass(frozen=True)
class AnswerKey:
    """Our adjustment of the rays that the report lists, and the report; lengths in mm, standard deviations a
    posteriori."""

    report: Report
    adjustment: Adjustment
    pitch_mm: float
    order: NDArray[np.int64]
    """Where each ray of the adjustment stands in the report."""

    @property
    def _factor(self) -> float:
        return self.adjustment.variance_factor

    @cached_property
    def counts(self) -> dict[str, float]:
        """Observations, unknowns, conditions of the datum, redundancy, and sigma0 for an a-priori one of 0.5 um."""
        own, layout = self.adjustment, self.adjustment.layout
        return {
            "observations": 2 * len(layout.rays) + len(layout.distances),
            "unknowns": 6 * len(layout.images) + 3 * len(layout.points) + len(layout.common),
            "conditions": int(own.defect.sum()),
            "redundancy": own.redundancy,
            "sigma0_mm": float(np.sqrt(self._factor)) * _PRIOR_MM,
        }

    @cached_property
    def points(self) -> tuple[Array, Array]:
        """Coordinates (P, 3) and standard deviations (P, 3)."""
        blocks = self.adjustment.covariance.point_blocks() * self._factor
        return self.adjustment.state.points / _MM, np.sqrt(np.diagonal(blocks, axis1=1, axis2=2)) / _MM

    @cached_property
    def camera(self) -> tuple[Array, Array, Array]:
        """Values (7,), standard deviations (7,) and correlations (7, 7), y upwards and Ck below 0 as in the report."""
        scale = np.array([_SIGNS.get(name, 1.0) * self.pitch_mm ** _POWERS[name] for name in FREE])
        values = self.adjustment.state.interior[0, [PARAMETERS.index(name) for name in FREE]]
        common = self.adjustment.covariance.common * self._factor * np.outer(scale, scale)
        sigmas = np.sqrt(np.diag(common))
        return values * scale, sigmas, common / np.outer(sigmas, sigmas)

    @cached_property
    def images(self) -> tuple[Array, Array, Array]:
        """Centres (I, 3), standard deviations of centres and of rotations about the axes in rad (I, 6), and their
        correlations (I, 6, 7) with the camera."""
        covariance = self.adjustment.covariance
        sigmas = np.sqrt(np.diagonal(covariance.images(0), axis1=1, axis2=2) * self._factor)
        camera = np.sqrt(np.diag(covariance.common) * self._factor) * [_SIGNS.get(name, 1.0) for name in FREE]
        correlations = covariance.images_common(0) * self._factor / sigmas[:, :, None] / camera
        return self.adjustment.state.centre / _MM, sigmas / [*[_MM] * 3, 1, 1, 1], correlations

    @cached_property
    def rotations(self) -> Array:
        """Matrices (I, 3, 3) from the report's camera into the frame of the points."""
        return self.adjustment.state.R @ _FLIP

    @cached_property
    def rays(self) -> tuple[Array, Array, Array]:
        """Residuals computed less measured (N, 2), y upwards, redundancy numbers (N, 2) and test values (N, 2)."""
        residuals = -self.adjustment.residuals_px * [1.0, -1.0] * self.pitch_mm
        redundancy = self.adjustment.covariance.redundancy_numbers()
        variances = np.diagonal(self.adjustment.network.rays.cov_px2, axis1=1, axis2=2) * self._factor
        return residuals, redundancy, np.abs(residuals) / (self.pitch_mm * np.sqrt(variances * redundancy))


_SIGNS = {"c": -1.0, "y0": -1.0, "B2": -1.0}
_POWERS = {"c": 1, "x0": 1, "y0": 1, "A1": -2, "A2": -4, "B1": -1, "B2": -1}


def read(shape: RawTable) -> dict[str, list[Any]]:
    """The columns of one table of the network; raises CampaignFaults where a file is not as it should be."""
    document = {"campaign": {"name": "key", "kind": "photogrammetry"}, "files": _FILES}
    log = FaultLog()
    files = CampaignFiles(data_folder() / FOLDER, read_campaign(document))
    batches = [batch.columns for _, batch in read_table(files, shape, log)]
    log.raise_faults()
    return {name: [value for batch in batches for value in batch[name].to_pylist()] for name in batches[0]}


def answer_key(*, from_rays: bool = True) -> AnswerKey:
    """The network adjusted anew, in the frame of the report; started from the rays alone, or from the report gone
    astray."""
    report = read_report(data_folder() / FOLDER / "example.htm.gz")
    camera = {name: values[0] for name, values in read(CAMERAS).items()}
    rays, bars = read(IMAGE_POINTS), read(SCALE_BARS)
    points = tuple(str(int(number)) for number in report.points[:, 0])
    images = tuple(str(number) for number in range(1, len(report.images) + 1))
    sigma_px = {
        (str(int(image)), str(int(point))): sigma / (camera["pixel_um"] * _MM)
        for point, image, sigma in report.rays[:, [0, 1, 6]]
    }
    key = list(zip(rays["image"], rays["point"], strict=True))
    listed = np.array([one in sigma_px for one in key])
    network = Network(
        (
            Camera(
                camera["camera"],
                camera["width_px"],
                camera["height_px"],
                camera["balancing_radius_px"],
                camera["pixel_um"] * 1e-6,
                FREE,
            ),
        ),
        np.zeros(len(images), np.int64),
        np.zeros(len(images), np.int64),
        np.zeros(len(points), np.int64),
        Rays(
            np.array([images.index(image) for image in rays["image"]])[listed],
            np.array([points.index(point) for image, point in key if (image, point) in sigma_px]),
            np.stack([rays["x_px"], rays["y_px"]], axis=-1)[listed],
            np.array([sigma_px[one] ** 2 for one in key if one in sigma_px])[:, None, None] * np.eye(2),
            np.zeros(int(listed.sum()), np.int64),
        ),
        # the report counts the bar as one more observation, of a distance
        Bars(
            np.zeros(1, np.int64),
            np.array([points.index(bars["first"][0])]),
            np.array([points.index(bars["second"][0])]),
            np.array([bars["sigma_mm"][0] * _MM]),
            np.array([bars["length_mm"][0] * _MM]),
            np.zeros(1),
        ),
        KnownPoints.none(),
    )
    interior = _interior(camera)
    start = find_start(network, interior).state if from_rays else astray(report, interior)
    first = adjust(network, start)
    again = adjust(network, in_frame_of(first.state, report.points[:, 1:4] * _MM))
    place = {(str(int(image)), str(int(point))): row for row, (point, image) in enumerate(report.rays[:, :2])}
    order = np.array([place[one] for one in key if one in place])
    return AnswerKey(report, again, camera["pixel_um"] * _MM, order)


def _interior(camera: dict[str, Any]) -> Array:
    """Prior values of the camera (1, 10): the focal length written on the lens, and the fixed parameters."""
    given = {"c": _LENS_MM / (camera["pixel_um"] * _MM), "C1": camera["C1"], "C2": camera["C2"]}
    return np.array([[given.get(name, 0.0) for name in PARAMETERS]])


def astray(report: Report, interior: Array) -> NetworkState:
    """The report's state, each image turned by some 5 degrees and displaced by 50 mm, each point by 20 mm."""
    rng = np.random.default_rng(7)
    omega, phi, kappa = report.images[:, 3:].T
    turned = exp_so3(rng.normal(0.0, np.radians(5.0), (len(omega), 3)))
    return NetworkState(
        interior,
        turned @ axis_turn(0, omega) @ axis_turn(1, phi) @ axis_turn(2, kappa) @ _FLIP,
        (report.images[:, :3] + rng.normal(0.0, 50.0, (len(omega), 3))) * _MM,
        (report.points[:, 1:4] + rng.normal(0.0, 20.0, (len(report.points), 3))) * _MM,
        np.array([report.bar[2] * _MM]),
    )


def axis_turn(axis: int, angle: Array) -> Array:
    """Matrices (N, 3, 3) of turns by ``angle`` (N,) about one axis."""
    return exp_so3(angle[:, None] * np.eye(3)[axis])


def in_frame_of(state: NetworkState, points_m: Array) -> NetworkState:
    """A state moved as a whole, without a change of scale, to where its points (P, 3) lie nearest to these."""
    ours, theirs = state.points - state.points.mean(axis=0), points_m - points_m.mean(axis=0)
    left, _, right = np.linalg.svd(theirs.T @ ours)
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return NetworkState(
        state.interior,
        turn @ state.R,
        (state.centre - state.points.mean(axis=0)) @ turn.T + points_m.mean(axis=0),
        ours @ turn.T + points_m.mean(axis=0),
        state.bar_length_m,
    )


@dataclass(frozen=True)
class Item:
    """One kind of number of the report: how many, the largest difference from ours, how finely the report prints it,
    and the largest difference in standard deviations, or as a share of the number itself."""

    what: str
    numbers: int
    largest: float
    step: float
    unit: str
    relative: str = ""

    @property
    def agrees(self) -> bool:
        """Return True if every number agrees with the report to its last digit."""
        return self.largest <= 0.5 * self.step * (1 + 1e-6)


def items(key: AnswerKey) -> list[Item]:
    """Every kind of number of the report next to ours."""
    report = key.report
    listed = report.rays[key.order]
    xyz, point_sigmas = key.points
    values, camera_sigmas, camera_correlation = key.camera
    centres, image_sigmas, correlations = key.images
    residuals, redundancy, tests = key.rays
    fine = np.abs(tests - listed[:, 10:12])
    turned = _turn_between(key)
    digits = _last_digits(report.camera)
    return [
        _item("object points: coordinates", xyz - report.points[:, 1:4], 1e-4, "mm", point_sigmas),
        _item("object points: standard deviations", point_sigmas - report.points[:, 4:], 1e-4, "mm"),
        _item("camera: values, in units of the last digit", (values - report.camera[:, 0]) / digits[:, 0], 1.0, ""),
        _item("camera: standard deviations, likewise", (camera_sigmas - report.camera[:, 1]) / digits[:, 1], 1.0, ""),
        _item("camera: correlations", camera_correlation - report.camera_correlation, 1e-3, ""),
        _item("images: centres", centres - report.images[:, :3], 1e-4, "mm", image_sigmas[:, :3]),
        _item("images: standard deviations of centres", image_sigmas[:, :3] - report.image_sigmas[:, :3], 1e-4, "mm"),
        _item("images: rotations", turned, 1e-8, "rad", image_sigmas[:, 3:]),
        _item(
            "images: twice the standard deviations of rotations",
            2 * image_sigmas[:, 3:] - report.axis_sigmas,
            1e-6,
            "rad",
        ),
        _item("images: correlations with the camera", correlations - report.image_correlation, 1e-3, ""),
        _item("rays: residuals", residuals - listed[:, 4:6], 1e-6, "mm"),
        _item("rays: redundancy numbers", redundancy - listed[:, 8:10], 1e-2, ""),
        _item("rays: test values", fine, 1e-2, ""),
    ]


def _item(what: str, difference: Array, step: float, unit: str, sigma: Array | None = None) -> Item:
    relative = "" if sigma is None else f"{np.max(np.abs(difference) / sigma):.3f} sigma"
    return Item(what, difference.size, float(np.max(np.abs(difference))), step, unit, relative)


def _turn_between(key: AnswerKey) -> Array:
    """The rotation vectors (I, 3) between the report's images and ours."""
    omega, phi, kappa = key.report.images[:, 3:].T
    listed = axis_turn(0, omega) @ axis_turn(1, phi) @ axis_turn(2, kappa)
    return log_so3(listed @ np.swapaxes(key.rotations, 1, 2))


def _last_digits(values: Array) -> Array:
    """Step of the last of seven printed digits."""
    return 10.0 ** (np.floor(np.log10(np.abs(values))) - 6)


def tables(key: AnswerKey) -> dict[str, Callable[[], str]]:
    """The tables of the page."""
    return {
        "counts": lambda: _counts_table(key),
        "camera": lambda: _camera_table(key),
        "items": lambda: _items_table(key),
    }


def _counts_table(key: AnswerKey) -> str:
    listed = key.report.counts
    rows = [[name.replace("_mm", ", mm"), _count(listed[name]), _count(ours)] for name, ours in key.counts.items()]
    length = float(np.linalg.norm(np.subtract(*key.points[0][_bar_ends(key)])))
    rows.append(["length of the scale bar, mm", f"{key.report.bar[2]:.4f}", f"{length:.4f}"])
    return table(["", "report", "here"], rows)


def _count(value: float) -> str:
    return f"{value:.6f}" if value < 1 else f"{value:.0f}"


def _bar_ends(key: AnswerKey) -> list[int]:
    numbers = key.report.points[:, 0].tolist()
    return [numbers.index(end) for end in key.report.bar[:2]]


def _camera_table(key: AnswerKey) -> str:
    values, sigmas, _ = key.camera
    rows = [
        [name, f"{listed[0]:.6e}", f"{value:.6e}", f"{listed[1]:.6e}", f"{sigma:.6e}"]
        for name, listed, value, sigma in zip(_REPORTED, key.report.camera, values, sigmas, strict=True)
    ]
    return table(["", "report", "here", "its sigma, report", "its sigma, here"], rows)


_REPORTED = ("Ck, mm", "Xh, mm", "Yh, mm", "A1, mm^-2", "A2, mm^-4", "B1, mm^-1", "B2, mm^-1")


def _items_table(key: AnswerKey) -> str:
    rows = [
        [
            item.what,
            str(item.numbers),
            f"{item.step:g} {item.unit}".strip(),
            f"{item.largest:.1g} {item.unit}".strip(),
            item.relative,
        ]
        for item in items(key)
    ]
    return table(["", "numbers", "last digit of the report", "largest difference", "in standard deviations"], rows)


if __name__ == "__main__":
    if not (data_folder() / FOLDER).is_dir():
        sys.exit(f"the answer key is not there: {data_folder() / FOLDER}")
    renew(PAGE, tables(answer_key()))
