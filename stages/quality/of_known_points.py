"""Whether known points lie where rays and the other known points have them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.numbers import count as counted
from truing.stages.common.words import listed
from truing.stages.quality.bundle_figures import rows_of
from truing.stages.quality.check import FAIL, PASS, Check, without

if TYPE_CHECKING:
    import pyarrow as pa

_LEVEL = 1e-3
_TOLD = 4  # as many as a sentence holds


def known_points(errors: pa.Table | None) -> Iterator[Check]:
    """A row per pose with known points that are the datum."""
    if errors is None or not errors.num_rows:
        yield without("known points", "known-points", "", "none are the datum")
        return
    for pose in dict.fromkeys(errors.column("pose").to_pylist()):
        yield _known(f"pose {pose}", rows_of(errors, "pose", pose).to_pylist())


def _known(subject: str, rows: list[dict[str, Any]]) -> Check:
    """The points of a pose, by the least p-value times how many were tested."""
    tested = [row for row in rows if row["p_value"] is not None]
    lost = [row["point"] for row in rows if not row["rays"]]
    wrong = sorted((row for row in tested if row["reason"]), key=_distance, reverse=True)
    if not tested and not lost:
        return without("known points", "known-points", subject, "rays alone do not check them")
    p_value = min((row["p_value"] for row in tested), default=1.0) * max(len(tested), 1)
    said = f"{subject}: {counted(len(rows), 'known point')}"
    if wrong:
        said += f"; {wrong[0]['reason']}: {'; '.join(map(_off, wrong[:_TOLD]))}"
        said += f"; and {len(wrong) - _TOLD} more" if len(wrong) > _TOLD else ""
    said += f"; without any ray that is left, and not measured: {listed(lost)}" if lost else ""
    if not wrong and tested:
        worst = max(tested, key=_distance)
        said += f"; the furthest is {_off(worst)}"
    verdict = FAIL if wrong or lost else PASS
    return Check("known-points", subject, min(p_value, 1.0), _LEVEL, "1", verdict, f"{said}.")


def _distance(row: dict[str, Any]) -> float:
    return float(np.linalg.norm([row["dx_mm"], row["dy_mm"], row["dz_mm"]]))


def _off(row: dict[str, Any]) -> str:
    """By how much, and where to, a known point is off."""
    off = np.array([row["dx_mm"], row["dy_mm"], row["dz_mm"]])
    size, spread = float(np.linalg.norm(off)), [row[f"sigma_{axis}_mm"] for axis in "xyz"]
    own = "" if None in spread else f" ± {np.linalg.norm(off / max(size, 1e-12) * np.array(spread)):.2g}"
    along = ", ".join(f"{axis} {value:+.3g}" for axis, value in zip("xyz", off, strict=True))
    return f"{row['point']} is known {size:.3g}{own} mm from where it is ({along})"
