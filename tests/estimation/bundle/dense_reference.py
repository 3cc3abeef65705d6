"""Dense reference adjustment: all rows and unknowns at once, with the datum as constraints."""

from __future__ import annotations

import numpy as np

from truing.estimation.bundle.network import linearise


def unknowns(adjustment):
    """Return the offsets of points and of common unknowns, and the number of all unknowns."""
    layout = adjustment.layout
    points = 6 * len(layout.images)
    common = points + 3 * len(layout.points)
    return points, common, common + len(layout.common)


def rows_and_information(adjustment):
    """Return the rows (n, u) of all observations with an error, their information (n, n), and of rigid distances."""
    network, layout, state = adjustment.network, adjustment.layout, adjustment.state
    at_points, at_common, count = unknowns(adjustment)
    rows, blocks, rigid = [], [], []
    rays = network.rays
    at = linearise(network, state, rays.image[layout.rays], rays.point[layout.rays])
    for n, ray in enumerate(layout.rays):
        row = np.zeros((2, count))
        row[:, 6 * layout.ray_image[n] :][:, :6] = at.by_image[n]
        row[:, at_points + 3 * layout.ray_point[n] :][:, :3] = at.by_point[n]
        for element, place in enumerate(layout.interior[network.image_camera[rays.image[ray]]]):
            if place >= 0:
                row[:, at_common + place] = at.by_interior[n, :, element]
        rows.append(row)
        blocks.append(np.linalg.inv(rays.cov_px2[ray]) * adjustment.weights[ray])
    for n, number in enumerate(layout.distances):
        row = np.zeros(count)
        a, b = layout.points[layout.first[n]], layout.points[layout.second[n]]
        along = (state.points[b] - state.points[a]) / np.linalg.norm(state.points[b] - state.points[a])
        row[at_points + 3 * layout.second[n] :][:3] = along
        row[at_points + 3 * layout.first[n] :][:3] = -along
        place = layout.bar[network.bars.bar[number]]
        if place >= 0:
            row[at_common + place] = -1
        sigma = network.bars.repeat_sigma_m[number]
        if sigma:
            rows.append(row[None])
            blocks.append(np.array([[sigma**-2.0]]))
        else:
            rigid.append(row)
    for bar, place in enumerate(layout.bar):
        if place >= 0:
            rows.append(np.eye(count)[None, at_common + place])
            blocks.append(np.array([[network.bars.sigma_m[bar] ** -2.0]]))
    for n, slot in zip(layout.known, layout.known_slot, strict=True):
        rows.append(np.eye(count)[at_points + 3 * slot :][:3])
        blocks.append(np.linalg.inv(network.known.cov_m2[n]))
    information = np.zeros((sum(map(len, rows)),) * 2)
    start = 0
    for block in blocks:
        information[start : start + len(block), start : start + len(block)] = block
        start += len(block)
    return np.concatenate(rows), information, np.array(rigid).reshape(-1, count)


def inner_constraints(adjustment, scale):
    """Return the six or seven inner constraints (., u) of every pose, over all its points."""
    layout, state = adjustment.layout, adjustment.state
    at_points, _, count = unknowns(adjustment)
    rows = []
    for pose in range(layout.poses):
        own = np.arange(layout.point_start[pose], layout.point_start[pose + 1])
        found = np.zeros((7, count))
        for slot in own:
            x, y, z = state.points[layout.points[slot]]
            block = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -z, y], [z, 0, -x], [-y, x, 0], [x, y, z]]
            found[:, at_points + 3 * slot :][:, :3] = block
        rows.append(found if scale else found[:6])
    return np.concatenate(rows)


def dense_covariance(adjustment, constraints):
    """Return the covariance (u, u) of all unknowns under constraints, rigid distances being constraints as well."""
    rows, information, rigid = rows_and_information(adjustment)
    normal = rows.T @ information @ rows
    held = np.concatenate([constraints, rigid])
    unit = np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    held = held / unit
    held /= np.linalg.norm(held, axis=1)[:, None]
    none = np.zeros((len(held), len(held)))
    whole = np.linalg.inv(np.block([[normal / np.outer(unit, unit), held.T], [held, none]]))
    return whole[: len(unit), : len(unit)] / np.outer(unit, unit)
