"""Read one C3D file in a separate process, since a damaged file may make ezc3d hang, crash or use all memory.

``python -m truing.formats.c3d_child FILE FOLDER BYTES`` writes the result to FOLDER for
`truing.formats.motion_capture`, or the reason of failure. BYTES: memory limit of the process, on systems that support
one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

FACTS, POINTS, REASON = "facts.json", "points.f64", "reason.txt"
_LONGEST = 80


def _limit_memory(size: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = size if hard == resource.RLIM_INFINITY else min(size, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


def _facts(file: Any) -> dict[str, Any]:
    group, header = file["parameters"]["POINT"], file["header"]["points"]
    labels = [label for key in sorted(group) if key.startswith("LABELS") for label in group[key]["value"]]
    unit = (group["UNITS"]["value"] if "UNITS" in group else []) or ["mm"]
    first, rate = int(header["first_frame"]), float(header["frame_rate"])
    return {"labels": labels, "unit": unit[0], "first": first, "rate": rate}


def _read(path: str, folder: Path) -> None:
    import ezc3d

    file = ezc3d.c3d(path)
    points, residuals = file["data"]["points"], file["data"]["meta_points"]["residuals"]
    values = np.ascontiguousarray(np.concatenate([points[:3], residuals[:1]]), dtype=np.float64)
    values.tofile(folder / POINTS)
    facts = {**_facts(file), "markers": values.shape[1], "frames": values.shape[2]}
    (folder / FACTS).write_text(json.dumps(facts), encoding="utf-8")


def _main(path: str, folder: str, size: str) -> None:
    _limit_memory(int(size))
    try:
        _read(path, Path(folder))
    except Exception as error:  # ezc3d passes on exceptions of its C++ code as several types
        (Path(folder) / REASON).write_text((str(error).splitlines() or [""])[0][:_LONGEST], encoding="utf-8")


if __name__ == "__main__":
    _main(*sys.argv[1:])
