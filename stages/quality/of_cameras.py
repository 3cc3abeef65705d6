"""Whether a camera stays as it is from pose to pose, by what the rays of each pose tell of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.quality.check import PASS, WARN, Check, without

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_WATCHED = ("c", "x0", "y0")
_BEYOND_CHANCE = 1e-3


def camera_stability(statistics: pa.Table | None, information: pa.Table | None) -> Iterator[Check]:
    """A row per camera: principal distance and point of each pose against those that all poses share."""
    if statistics is None or information is None or not statistics.num_rows:
        yield without("stability of cameras", "camera-stability", "", "the rays of single poses tell nothing of it")
        return
    poses = list(dict.fromkeys(statistics.column("pose").to_pylist()))
    cameras = [name for name in dict.fromkeys(statistics.column("shared_number").to_pylist()) if name.endswith(" c")]
    for named in cameras:
        camera = named.removesuffix(" c").removeprefix("camera ")
        watched = [named.removesuffix("c") + name for name in _WATCHED]
        if len(poses) < 2:
            yield without("stability", "camera-stability", f"camera {camera}", "there is but one pose")
            continue
        yield _stability(camera, poses, _scores(statistics, poses, watched), _blocks(information, poses, watched))


def _scores(table: pa.Table, poses: list[object], watched: list[str]) -> Array:
    """(S, 3) what the residuals of each pose say of the parameters."""
    out = np.zeros((len(poses), len(watched)))
    rows = zip(*(table.column(name).to_pylist() for name in ("pose", "shared_number", "score")), strict=True)
    for pose, parameter, value in rows:
        if parameter in watched:
            out[poses.index(pose), watched.index(parameter)] = value
    return out


def _blocks(table: pa.Table, poses: list[object], watched: list[str]) -> Array:
    """(S, 3, 3) how well each pose tells them, given all else that is common."""
    out = np.zeros((len(poses), len(watched), len(watched)))
    names = ("pose", "shared_number", "other_number", "information")
    for pose, one, other, value in zip(*(table.column(name).to_pylist() for name in names), strict=True):
        if one in watched and other in watched:
            i, j = watched.index(one), watched.index(other)
            out[poses.index(pose), i, j] = out[poses.index(pose), j, i] = value
    return out


def _stability(camera: str, poses: list[object], score: Array, information: Array) -> Check:
    """Chi-square of the poses' own values about their common one: n_p ~ N(N_p d, N_p)."""
    from scipy.special import chdtrc

    told = np.array([np.linalg.matrix_rank(block, hermitian=True) == len(_WATCHED) for block in information])
    if told.sum() < 2:
        return without("stability", "camera-stability", f"camera {camera}", "fewer than two poses tell of it")
    N, n = information[told], score[told]
    own = np.linalg.solve(N, n[..., None])[..., 0]
    common = np.linalg.solve(N.sum(axis=0), n.sum(axis=0))
    apart = own - common
    chi2 = float(np.einsum("pi,pij,pj->", apart, N, apart))
    freedom = len(_WATCHED) * (len(N) - 1)
    p_value = float(chdtrc(freedom, chi2))
    sigma = np.sqrt(np.diagonal(np.linalg.inv(N), axis1=1, axis2=2))
    worst = int(np.argmax(np.einsum("pi,pij,pj->p", apart, N, apart)))
    shown = ", ".join(f"{name} by {apart[worst, k]:+.2f} ± {sigma[worst, k]:.2f} px" for k, name in enumerate(_WATCHED))
    at = np.array([str(pose) for pose in poses])[told][worst]
    ratio = np.sqrt(chi2 / freedom)
    said = f"Camera {camera}: poses differ in principal distance and point by {ratio:.2f} times their uncertainty "
    said += f"(p = {p_value:.2g}); most in pose {at}: {shown}."
    trips = p_value < _BEYOND_CHANCE
    return Check("camera-stability", f"camera {camera}", p_value, _BEYOND_CHANCE, "1", WARN if trips else PASS, said)
