"""A stub library has the requested name and functions, and nothing else."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tests.packaging.source_tree import PROJECT
from truing.stub_library import missing_functions

pytestmark = pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="stand-ins are made for Linux on x86-64"
)

ASK = """
import ctypes
from truing.stub_library import provide_stub_library
for soname, functions in {(libraries)}:
    provide_stub_library(soname, functions)
    library = ctypes.CDLL(soname)
    print([getattr(library, name)() for name in functions], hasattr(library, "absent"))
"""


@pytest.mark.parametrize("count", [0, 1, 2, 700])
def test_every_function_is_found_by_the_systems_loader_and_returns_zero(count: int) -> None:
    names = [f"function_{i}" for i in range(count)]
    libraries = [("libfirst-of-two.so.1", names), ("libsecond-of-two.so.1", names[::-1])]
    program = ASK.replace("{(libraries)}", repr(libraries))
    outcome = subprocess.run([sys.executable, "-c", program], cwd=PROJECT, capture_output=True, text=True)
    assert outcome.stdout.splitlines() == [f"{[0] * count} False"] * 2, outcome.stderr


def test_missing_functions_are_those_that_a_library_leaves_to_others() -> None:
    import libusb_package

    library = Path(libusb_package.get_library_path())
    assert missing_functions(library, "malloc|free|libusb_init") == ["free", "malloc"]
