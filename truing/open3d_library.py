"""Loading Open3D where the system lacks a library that its wheels expect; everybody imports Open3D through here."""

from __future__ import annotations

import ctypes
import importlib
import sys
from types import ModuleType

_LIBUSB = "libusb-1.0.so.0"

_REMEDY = (
    "point-cloud files and dense scans need Open3D, which is not installed here. Its wheels exist for "
    "Python 3.11 to 3.14 on Linux (glibc 2.35 or newer), Windows on x86-64 and macOS on Apple silicon: use one of "
    "these and install again (`make setup`, or `pip install open3d`). Everything else works without it"
)


def load_open3d() -> ModuleType:
    """Return the module `open3d`, importing it on the first call (about half a second).

    Raises ImportError, with the remedy in its message, where Open3D has no wheel or cannot be loaded.
    """
    if "open3d" not in sys.modules:
        _provide_libusb()
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        if error.name != "open3d":
            raise
        raise ImportError(_REMEDY, name="open3d") from error


def _provide_libusb() -> None:
    """Make `libusb-1.0.so.0` resolvable: the wheels of Open3D for Linux link it and do not carry it."""
    if not sys.platform.startswith("linux") or _loads(_LIBUSB):
        return
    try:
        libusb_package = importlib.import_module("libusb_package")
    except ModuleNotFoundError:
        return  # Open3D's own message then names the library that is missing
    _loads(str(libusb_package.get_library_path()))


def _loads(library: str) -> bool:
    """Load a shared library for every library loaded after it; False where it cannot be."""
    try:
        ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return False
    return True
