"""Normal equations of a network: blocks of images and points per pose, bordered by the unknowns common to all poses.

Unknowns are images and points with rays, free interior elements of cameras with images, and bar lengths that are not
exactly known. Distances are separate rows: precise or exact ones enter by multipliers, which are stable for rigid bars
(`truing.estimation.bundle.elimination`).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.kernel_arguments import CameraArrays, EquationArrays, RayArrays, StateArrays
from truing.estimation.bundle.network import Network, NetworkState, format_centres
from truing.estimation.bundle.row_blocks import RowBlocks, row_blocks
from truing.estimation.rotation import exp_so3


@dataclass(frozen=True)
class EquationLayout:
    """Numbers of adjusted items and their slots.

    Rays (n,) sorted by image, images (i,) and points (p,) sorted by pose, with the first slot of each pose (S + 1,);
    image and point slot of each ray, and the first ray of each image (i + 1,); rows of distances (q,) and known points;
    place of each interior element (C, 10) and bar (K,) among the common unknowns, -1 if none.
    """

    rays: Index
    ray_image: Index
    ray_point: Index
    first_ray: Index
    images: Index
    points: Index
    image_start: Index
    point_start: Index
    distances: Index
    first: Index
    second: Index
    distance_pose: Index
    known: Index
    known_slot: Index
    interior: Index
    bar: Index
    common: tuple[tuple[str, str | int], ...]
    rows: RowBlocks

    @property
    def poses(self) -> int:
        """Number of poses, including those without rays."""
        return len(self.image_start) - 1


def equation_layout(network: Network, used: Mask, known: bool) -> EquationLayout:
    """Return the layout of the unknowns for the used rays (N,); known: whether known points are observations."""
    rays = network.rays
    images, image_slot, image_start = _slots(_distinct_numbers(rays.image[used]), network.image_pose, network.poses)
    rows = np.flatnonzero(used)
    rows = rows[np.argsort(image_slot[rays.image[rows]], kind="stable")]
    seen = _distinct_numbers(rays.point[rows])
    points, point_slot, point_start = _slots(seen, network.point_pose, network.poses)
    bars = network.bars
    distances = np.flatnonzero((point_slot[bars.first] >= 0) & (point_slot[bars.second] >= 0))
    interior, bar, common = _common(network, images, distances)
    # A known point without a ray carries no information about other unknowns.
    known_rows = np.flatnonzero(point_slot[network.known.point] >= 0) if known else np.empty(0, np.int64)
    ray_image, ray_point = image_slot[rays.image[rows]], point_slot[rays.point[rows]]
    first_ray = np.searchsorted(ray_image, np.arange(len(images) + 1))
    first, second = point_slot[bars.first[distances]], point_slot[bars.second[distances]]
    tied = np.zeros(len(points), bool)
    tied[first] = tied[second] = True
    return EquationLayout(
        rays=rows,
        ray_image=ray_image,
        ray_point=ray_point,
        first_ray=first_ray,
        images=images,
        points=points,
        image_start=image_start,
        point_start=point_start,
        distances=distances,
        first=first,
        second=second,
        distance_pose=network.point_pose[bars.first[distances]],
        known=known_rows,
        known_slot=point_slot[network.known.point[known_rows]],
        interior=interior,
        bar=bar,
        common=common,
        rows=row_blocks(image_start, point_start, first_ray, ray_image, ray_point, tied),
    )


def _distinct_numbers(numbers: Index) -> Index:
    """Return the distinct numbers in ascending order."""
    return np.flatnonzero(np.bincount(numbers))


def _slots(numbers: Index, pose: Index, poses: int) -> tuple[Index, Index, Index]:
    """Return numbers sorted by pose, the slot of every number or -1, and the first slot of each pose."""
    ordered = numbers[np.argsort(pose[numbers], kind="stable")]
    slot = np.full(len(pose), -1)
    slot[ordered] = np.arange(len(ordered))
    return ordered, slot, np.searchsorted(pose[ordered], np.arange(poses + 1))


def _common(network: Network, images: Index, distances: Index) -> tuple[Index, Index, tuple]:
    """Return the places of interior elements and bars among the common unknowns, and the name of each unknown."""
    interior = np.full((len(network.cameras), len(PARAMETERS)), -1)
    common: list[tuple[str, str | int]] = []
    for camera in np.unique(network.image_camera[images]):
        for name in network.cameras[camera].free:
            interior[camera, PARAMETERS.index(name)] = len(common)
            common.append((network.cameras[camera].name, name))
    bar = np.full(len(network.bars.length_m), -1)
    for number in np.unique(network.bars.bar[distances]):
        if network.bars.sigma_m[number] > 0:
            bar[number] = len(common)
            common.append(("bar", int(number)))
    return interior, bar, tuple(common)


class ArrayPool:
    """Reusable arrays by name; an array is valid until the same name is taken again."""

    def __init__(self) -> None:
        self._arrays: dict[Hashable, Array] = {}

    def take(self, name: Hashable, shape: tuple[int, ...]) -> Array:
        """Return an array of a shape with undefined content."""
        array = self._arrays.get(name)
        if array is None or array.shape != shape:
            array = self._arrays[name] = np.empty(shape)
        return array


@dataclass(frozen=True)
class Observed:
    """Observations of an adjustment with their information.

    Image points (n, 2) in px with information (n, 2, 2) in px^-2 and its upper root (n, 3) as xx, xy, yy; information
    of known points (m, 3, 3) in m^-2 and of bar lengths (K,) in m^-2, zero if they are not unknowns; variance of
    distances (q,) in m^2; formats: centre (C, 2) and balancing radius (C,) of cameras in px.
    """

    network: Network
    layout: EquationLayout
    xy_px: Array
    rays: Array
    roots: Array
    known: Array
    bars: Array
    distance_variance: Array
    formats: tuple[Array, Array]


@dataclass(frozen=True)
class Distances:
    """Distances at a state: unit vector (q, 3) from the first to the second point; misclosure (q,) in m: bar length
    minus distance."""

    direction: Array
    misclosure: Array


@dataclass(frozen=True)
class NormalEquations:
    """Blocks of the normal equations.

    Images (i, 6, 6); points (p, 3, 3); images by points per pose (6 i, 3 p), or by ray (n, 6, 3) in large poses; sides
    of images (i, 6, c + 1), of points (p, 3, c + 1) and of the common unknowns (c, c + 1): the common unknowns, then
    the right side. chi2: weighted sum of squares without distances.
    """

    images: Array
    points: Array
    between: tuple[Array, ...]
    image_sides: Array
    point_sides: Array
    common: Array
    distances: Distances
    chi2: float


@dataclass(frozen=True)
class UnknownsStep:
    """Step of all unknowns: images (i, 6) in the order (centre, theta), points (p, 3), common (c,), and the multipliers
    (q,) of the distances, 0 if they have none."""

    images: Array
    points: Array
    common: Array
    multipliers: Array


def observe(network: Network, layout: EquationLayout, weights: Array, variance_factor: Array) -> Observed:
    """Return the observations with their information; weights (N,) in [0, 1] and covariance factors (N,) of all
    rays."""
    rows = layout.rays
    (xx, xy), (_, yy) = network.rays.cov_px2[rows].transpose(1, 2, 0)
    per = weights[rows] / variance_factor[rows] / (xx * yy - xy * xy)
    rays = np.stack([yy * per, -xy * per, -xy * per, xx * per], -1).reshape(-1, 2, 2)
    root = np.sqrt(yy * per)
    roots = np.stack([root, -xy * per / root, np.sqrt(weights[rows] / variance_factor[rows] / yy)], -1)
    lengths = np.zeros(len(layout.bar))
    free = layout.bar >= 0
    lengths[free] = network.bars.sigma_m[free] ** -2
    known = np.asarray(np.linalg.inv(network.known.cov_m2[layout.known]), np.float64)
    variance = network.bars.repeat_sigma_m[layout.distances] ** 2
    xy = network.rays.xy_px[rows]
    return Observed(network, layout, xy, rays, roots, known, lengths, variance, format_centres(network))


def distances_at(observed: Observed, state: NetworkState) -> Distances:
    """Return the distances between the ends of bars."""
    layout, bars = observed.layout, observed.network.bars
    points = state.points[layout.points]
    between = points[layout.second] - points[layout.first]
    length = np.linalg.norm(between, axis=-1)
    return Distances(between / length[:, None], state.bar_length_m[bars.bar[layout.distances]] - length)


def sum_of_squares(observed: Observed, state: NetworkState) -> float:
    """Return the weighted sum of squares without distances; infinite if a point is not in front of its camera."""
    from truing.estimation.bundle.kernels import weighted_squares

    return float(weighted_squares(*_kernel_arguments(observed, state))) + _prior_squares(observed, state)


def residuals(network: Network, state: NetworkState) -> Array:
    """Return measured minus computed image points (N, 2) in px of all rays, as `network.project`."""
    from truing.estimation.bundle.kernels import image_points

    rays, xy = network.rays, np.empty((network.rays.count, 2))
    cameras = CameraArrays(network.image_camera, state.interior, *format_centres(network))
    image_points(rays.image, rays.point, cameras, StateArrays(state.R, state.centre, state.points), xy)
    return rays.xy_px - xy


def _kernel_arguments(observed: Observed, state: NetworkState) -> tuple[RayArrays, CameraArrays, StateArrays]:
    """Return used rays, cameras, and adjusted images and points for the compiled kernels."""
    layout, network = observed.layout, observed.network
    # The kernels are compiled once for each order of the arrays' axes in memory, so all of them have the same.
    of_image, interior = network.image_camera[layout.images], np.ascontiguousarray(state.interior)
    R = np.ascontiguousarray(state.R[layout.images])
    return (
        RayArrays(observed.xy_px, observed.roots, layout.first_ray, layout.ray_point),
        CameraArrays(of_image, interior, *observed.formats),
        StateArrays(R, state.centre[layout.images], state.points[layout.points]),
    )


def _prior_squares(observed: Observed, state: NetworkState) -> float:
    """Return the weighted sum of squares of known points and lengths of bars."""
    if not len(observed.known) and not len(observed.bars):
        return 0.0
    known = _misclosure_of_known(observed, state)
    lengths = observed.network.bars.length_m - state.bar_length_m
    return float(np.einsum("mi,mij,mj", known, observed.known, known) + observed.bars @ lengths**2)


def _misclosure_of_known(observed: Observed, state: NetworkState) -> Array:
    """Return known minus estimated coordinates (m, 3)."""
    known, rows = observed.network.known, observed.layout.known
    return known.xyz_m[rows] - state.points[known.point[rows]]


def normal_equations(observed: Observed, state: NetworkState, workspace: ArrayPool) -> NormalEquations:
    """Return the normal equations at a state; valid until the next call with the same workspace.

    If a point is not in front of its camera, the sum of squares is infinite and the rest undefined.
    """
    from truing.estimation.bundle.kernels import accumulate

    layout = observed.layout
    i, p, c, rows = len(layout.images), len(layout.points), len(layout.common), layout.rows
    flat = workspace.take("between", (int(rows.start[-1]),))
    flat[:] = 0.0
    equations = EquationArrays(
        slot=layout.interior,
        first_entry=rows.ray,
        stride=rows.length,
        images=np.empty((i, 6, 6)),
        image_sides=np.zeros((i, 6, c + 1)),
        points=np.zeros((p, 3, 3)),
        point_sides=np.zeros((p, 3, c + 1)),
        common=np.zeros((c, c + 1)),
        flat=flat,
    )
    chi2 = accumulate(*_kernel_arguments(observed, state), equations)
    between = tuple(
        flat[a:b].reshape(shape) for a, b, shape in zip(rows.start[:-1], rows.start[1:], rows.shapes, strict=True)
    )
    total = chi2 + _prior_squares(observed, state)
    blocks = NormalEquations(
        images=equations.images,
        points=equations.points,
        between=between,
        image_sides=equations.image_sides,
        point_sides=equations.point_sides,
        common=equations.common,
        distances=distances_at(observed, state),
        chi2=total,
    )
    _add_priors(observed, state, blocks)
    return blocks


def _add_priors(observed: Observed, state: NetworkState, blocks: NormalEquations) -> None:
    """Add the information of known points and bar lengths."""
    layout = observed.layout
    if not len(observed.known) and not len(observed.bars):
        return
    np.add.at(blocks.points, layout.known_slot, observed.known)
    known = np.einsum("mij,mj->mi", observed.known, _misclosure_of_known(observed, state))
    np.add.at(blocks.point_sides[..., -1], layout.known_slot, known)
    free = np.flatnonzero(layout.bar >= 0)
    index = layout.bar[free]
    blocks.common[index, index] += observed.bars[free]
    misclosure = observed.network.bars.length_m[free] - state.bar_length_m[free]
    blocks.common[index, -1] += observed.bars[free] * misclosure


def stepped_state(layout: EquationLayout, state: NetworkState, step: UnknownsStep) -> NetworkState:
    """Return the state after a step."""
    R, centre, points = state.R.copy(), state.centre.copy(), state.points.copy()
    R[layout.images] = exp_so3(step.images[:, 3:]) @ R[layout.images]
    centre[layout.images] += step.images[:, :3]
    points[layout.points] += step.points
    interior, lengths = state.interior.copy(), state.bar_length_m.copy()
    free = layout.interior >= 0
    interior[free] += step.common[layout.interior[free]]
    bars = layout.bar >= 0
    lengths[bars] += step.common[layout.bar[bars]]
    return NetworkState(interior, R, centre, points, lengths)
