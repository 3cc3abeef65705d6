"""The telescope's observability Jacobian, row by row from equations 34 to 37 of its report (corrected), in mm."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import K, telescope
from truing.simulation.mechanisms.legs.kinematics import forward

REFERENCE: dict[str, Any] = json.loads((Path(__file__).parent / "telescope_reference.json").read_text(encoding="utf-8"))
LEVELS = np.array(REFERENCE["levels"], float)
DRHO_MM = REFERENCE["half_range_mm"] * LEVELS
LEGS = range(6)
COLUMNS = ("ax", "ay", "az", "bx", "by", "bz", "ux", "uy", "l", "rho0", "kappa")


def rows(names: list[str], leg: int) -> NDArray:
    """The derivatives (40, P) of a leg's length less the distance that it spans, per mm, u and kappa per 1."""
    p, R = poses()
    return leg_rows(p, R, DRHO_MM[:, leg], leg)[:, [COLUMNS.index(name) for name in names]]


@cache
def poses(deformation: float = 0.0) -> tuple[NDArray, NDArray]:
    """p (40, 3) in mm and R (40, 3, 3) of the telescope at table 3, whose platform deforms by a part of K."""
    legs, drho = telescope(), DRHO_MM * 1e-3
    found = forward(legs, legs.rho0 + drho, deformation * drho @ K.T)
    assert found.converged.all()
    return 1e3 * found.p, found.R


def leg_rows(p: NDArray, R: NDArray, drho: NDArray, leg: int) -> NDArray:
    """Rows (B, 11), as in COLUMNS, of the rigid model at p (B, 3), R (B, 3, 3) and displacements (B,), in mm."""
    z, u, rho = directions(p, R, drho, leg), telescope().u[leg], drho + 1e3 * telescope().rho0[leg]
    by_b = -np.einsum("bji,bj->bi", R, z)
    by_u = rho[:, None] * (z[:, :2] - (u[:2] / u[2]) * z[:, 2:])
    by_kappa = -np.einsum("bi,bi->b", z, R[:, :, 2]) * drho
    return np.column_stack([z, by_b, by_u, np.ones(len(z)), z @ u, by_kappa])


def directions(p: NDArray, R: NDArray, drho: NDArray, leg: int) -> NDArray:
    """Unit vectors (B, 3) along a leg."""
    g = gaps(p, R, drho, leg)
    return g / np.linalg.norm(g, axis=1, keepdims=True)


def gaps(p: NDArray, R: NDArray, drho: NDArray, leg: int) -> NDArray:
    """Vectors (B, 3) in mm from lower to upper joint of a leg whose platform is rigid."""
    legs = telescope()
    lower = 1e3 * legs.a[leg] + (drho + 1e3 * legs.rho0[leg])[:, None] * legs.u[leg]
    return p + R @ (1e3 * legs.b[leg]) - lower
