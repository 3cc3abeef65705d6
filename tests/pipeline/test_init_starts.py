"""`truing init` on files of a target each whose names give different starts or steps: are their poses the same?"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pipeline.test_init_exports import init

HEAD = "Enabled\tFeature\tID\tx\ty\tz"


def _doubts(folder: Path, names: tuple[str, ...]) -> str:
    for number, name in enumerate(names):
        rows = [f"Checked\t{name}\t{row}\t-5,231.6{row}\t-2,701.0{number}\t1,263.7" for row in (1, 2, 3)]
        (folder / name).write_text("\n".join([HEAD, *rows, ""]))
    _, document = init(folder)
    assert "from_name" in document["files"]["points"]
    lines = (folder / "campaign.toml").read_text().splitlines()
    return next(line for line in lines if line.startswith("# check:"))


@pytest.mark.parametrize(
    ("names", "differing"),
    [
        (("M1_left_step_10deg_start_40deg.txt", "M1_right_step_10deg_start_60deg.txt"), "start 40, start 60"),
        (("M1_left_step_10deg.txt", "LATR_1_step_5deg.txt", "LATR_2_step_5deg.txt"), "step 10, step 5"),
    ],
)
def test_other_starts_and_steps_in_names_leave_open_whether_poses_are_the_same(
    tmp_path: Path, names: tuple[str, ...], differing: str
) -> None:
    parts = next(part for part in _doubts(tmp_path, names).split("; ") if "same pose" in part)
    assert set(parts.partition("differ also in ")[2].partition(":")[0].split(", ")) == set(differing.split(", "))


def test_one_start_written_in_two_ways_leaves_nothing_open(tmp_path: Path) -> None:
    names = ("M2_Lower_Left_step_start40.txt", "M2_Lower_Right_step_start40.txt", "M2_Upper_Left_step_start_40deg.txt")
    assert "same pose" not in _doubts(tmp_path, names)
