"""Without optional libraries everything else runs, and inputs that need one give the installation command."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from truing.pipeline.problems import ExitCode

# Stands in for a machine for which these libraries have no wheel, or where nobody installed them.
HIDING = """
import sys

class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {names}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Hidden())
if __name__ == "__main__":
    from truing.pipeline.entry import main
    main()
"""
ALL = {"open3d", "cv2", "h5py", "ezc3d", "openpyxl", "distributed", "dask", "libusb_package"}


def _truing(place: Path, *words: str, hidden: set[str] = ALL) -> subprocess.CompletedProcess[str]:
    script = place / "hiding.py"
    script.write_text(HIDING.format(names=hidden), encoding="utf-8")
    environment = {**os.environ, "PYTHONWARNINGS": "ignore"}
    call = [sys.executable, str(script), *words]
    return subprocess.run(call, cwd=place, env=environment, capture_output=True, text=True, check=False)


def test_points_are_analysed_without_them(workplace: Path, tmp_path: Path) -> None:
    done = _truing(tmp_path, "run", str(workplace / "sample_data" / "telescope"), "--out", str(tmp_path / "run"))
    assert done.returncode in (ExitCode.DONE, ExitCode.FAILED_CHECK), done.stderr
    assert (tmp_path / "run" / "report.html").is_file()


def test_a_cluster_names_its_extra(workplace: Path, tmp_path: Path) -> None:
    campaign = str(workplace / "sample_data" / "telescope")
    done = _truing(tmp_path, "run", campaign, "--scheduler", "tcp://127.0.0.1:8786", "--out", str(tmp_path / "run"))
    assert done.returncode == ExitCode.ENVIRONMENT
    assert 'pip install "truing[cluster]"' in done.stderr


def test_without_dask_processes_of_this_machine_do_the_work_of_a_local_cluster(tmp_path: Path) -> None:
    done = _truing(tmp_path, "run", "absent", "missing", "--scheduler", "local", "--workers", "3")
    assert done.returncode == ExitCode.UNUSABLE_CAMPAIGN
    assert 'pip install "truing[cluster]"' in done.stderr
    assert "2 campaigns: 3 processes" in done.stdout


def test_photographs_name_their_library(tmp_path: Path) -> None:
    from tests.conftest import PROJECT

    campaign = str(PROJECT / "sample_data" / "telescope-images")
    done = _truing(tmp_path, "run", campaign, "--only", "images", "--out", str(tmp_path / "run"))
    assert done.returncode == ExitCode.ENVIRONMENT
    assert "pip install opencv-contrib-python-headless" in done.stderr
