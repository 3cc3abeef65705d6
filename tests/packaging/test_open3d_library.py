"""Open3D loads on a minimal machine, and its absence is reported with a remedy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.packaging.source_tree import PROJECT

HIDE_OPEN3D = """
import importlib.util
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "open3d" else find(name, *rest)
from truing.open3d_library import load_open3d
load_open3d()
"""

BREAK_OPEN3D = """
import sys
class Broken:
    def find_spec(self, name, path=None, target=None):
        if name == "open3d.pybind":
            raise ImportError("libnone.so.1: cannot open shared object file")
sys.meta_path.insert(0, Broken())
from truing.open3d_library import load_open3d
load_open3d()
"""

# What the system offers under these names is hidden; only what stands in for it may serve.
BARE_MACHINE = """
import ctypes, sys
real, loaded = ctypes.CDLL, []
def without_system_libraries(name, *arguments, **keywords):
    if name in ("libusb-1.0.so.0", "libEGL.so.1", "libGL.so.1", "libX11.so.6"):
        raise OSError(name)
    loaded.append(name)
    return real(name, *arguments, **keywords)
ctypes.CDLL = without_system_libraries
from truing.open3d_library import load_open3d
cloud = load_open3d().io.read_point_cloud(sys.argv[1])
print(len(cloud.points), any("libusb_package" in name for name in loaded), sum("/fd/" in name for name in loaded))
"""


def run(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program, *arguments], cwd=PROJECT, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("program", "remedy"), [(HIDE_OPEN3D, "make setup"), (BREAK_OPEN3D, "libnone.so.1"), (BREAK_OPEN3D, "libegl1")]
)
def test_absence_is_reported_with_the_remedy(program: str, remedy: str) -> None:
    outcome = run(program)
    assert outcome.returncode == 1
    assert remedy in outcome.stderr.splitlines()[-1]
    assert "ImportError" in outcome.stderr.splitlines()[-1]


@pytest.mark.skipif(sys.platform != "linux", reason="only the wheels for Linux need these libraries")
def test_a_cloud_is_read_where_the_system_has_no_libusb_and_no_graphics(tmp_path: Path) -> None:
    cloud = tmp_path / "cloud.xyz"
    cloud.write_text("0 0 0\n1 0 0\n0 1 0\n", encoding="utf-8")
    outcome = run(BARE_MACHINE, str(cloud))
    assert outcome.stdout.split() == ["3", "True", "3"], outcome.stderr
