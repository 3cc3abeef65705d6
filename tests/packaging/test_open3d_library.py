"""Open3D loads on a machine without libusb, and its absence is said with the remedy."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.packaging.source_tree import PROJECT

HIDE_OPEN3D = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name == "open3d":
            raise ModuleNotFoundError("No module named 'open3d'", name="open3d")
sys.meta_path.insert(0, Absent())
from truing.open3d_library import load_open3d
load_open3d()
"""

# What the system offers is hidden; only what the wheel carries may serve.
HIDE_LIBUSB = """
import ctypes
real, loaded = ctypes.CDLL, []
def without_system_libusb(name, *arguments, **keywords):
    if name == "libusb-1.0.so.0":
        raise OSError(name)
    loaded.append(name)
    return real(name, *arguments, **keywords)
ctypes.CDLL = without_system_libusb
from truing.open3d_library import load_open3d
print(load_open3d().geometry.PointCloud().is_empty(), any("libusb_package" in str(name) for name in loaded))
"""


def run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], cwd=PROJECT, capture_output=True, text=True)


def test_absence_names_the_remedy() -> None:
    outcome = run(HIDE_OPEN3D)
    assert outcome.returncode == 1
    assert "ImportError" in outcome.stderr
    assert "make setup" in outcome.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only the wheels for Linux need libusb")
def test_libusb_comes_from_a_wheel_where_the_system_has_none() -> None:
    outcome = run(HIDE_LIBUSB)
    assert outcome.stdout.split() == ["True", "True"], outcome.stderr
