"""The sample telescope, shortened for speed: few poses, no targets on the legs."""

from __future__ import annotations

import shutil
from pathlib import Path

SAMPLE = Path(__file__).resolve().parents[1] / "sample_data" / "telescope"
_POSES = {*map(str, range(7)), "41", "42"}
_KEPT = (("points.csv", 0), ("configurations.csv", 0), ("points.csv", 1), ("targets.csv", 0))


def cut_telescope(folder: Path) -> Path:
    """Write the campaign into a folder that is not there yet."""
    shutil.copytree(SAMPLE, folder)
    for name, column in _KEPT:
        header, *rows = (folder / name).read_text().splitlines()
        wanted = (row for row in rows if row.split(",")[column] in {*_POSES, "base", "platform"})
        (folder / name).write_text("\n".join([header, *wanted]) + "\n")
    return folder
