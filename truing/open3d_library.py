"""Import of Open3D on systems without the libraries that its wheels expect; all modules import it with
`load_open3d`."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import platform
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from truing.stub_library import missing_functions, provide_stub_library

if TYPE_CHECKING:
    from open3d.geometry import PointCloud as PointCloud
    from open3d.pipelines.registration import RegistrationResult as RegistrationResult

_LIBUSB = "libusb-1.0.so.0"
# Graphics libraries that Open3D links, and the names of the functions that each defines.
_GRAPHICS = {"libEGL.so.1": r"egl[A-Z]\w*", "libGL.so.1": r"gl[A-Z]\w*", "libX11.so.6": r"X[A-Z]\w*"}

_NOT_INSTALLED = (
    "dense scans need Open3D, which is not installed here. Its wheels exist for "
    "Python 3.11 to 3.14 on Linux (glibc 2.35 or newer), Windows on x86-64 and macOS on Apple silicon: use one of "
    "these and install again (`make setup`, or `pip install open3d`). Everything else works without it"
)
_NOT_LOADED = (
    "Open3D is installed and does not load: {}. Where a system library is missing, install it "
    "(Debian and Ubuntu: apt-get install libegl1 libgl1 libusb-1.0-0 libx11-6). Only dense scans need it"
)


def load_open3d() -> ModuleType:
    """Return the module `open3d`, importing it on the first call (about half a second).

    Raises ImportError, with the remedy in its message, if Open3D has no wheel or cannot be loaded.
    """
    if "open3d" in sys.modules:
        return sys.modules["open3d"]
    package = importlib.util.find_spec("open3d")
    if package is None or package.origin is None:
        raise ImportError(_NOT_INSTALLED, name="open3d")
    if sys.platform.startswith("linux"):
        _provide_libusb()
        _provide_graphics(Path(package.origin).parent)
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        raise ImportError(_NOT_LOADED.format(error), name="open3d") from error


def _provide_libusb() -> None:
    """Load libusb from the wheel `libusb-package` if the system lacks it; Open3D does not contain it."""
    if not _loads(_LIBUSB) and importlib.util.find_spec("libusb_package"):
        library = importlib.import_module("libusb_package").get_library_path()
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)


def _provide_graphics(package: Path) -> None:
    """Provide stubs of graphics libraries on a machine without a screen: truing calls none of their functions."""
    absent = [soname for soname in _GRAPHICS if not _loads(soname)]
    if absent and platform.machine() == "x86_64":
        for library in package.glob("libOpen3D.so*"):
            for soname in absent:
                provide_stub_library(soname, missing_functions(library, _GRAPHICS[soname]))


def _loads(library: str) -> bool:
    """True if the system has a shared library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
