"""Compiled files are kept while tests run, whatever the environment variables."""

from __future__ import annotations

import subprocess
import sys


def test_neither_the_tests_nor_their_processes_compile_a_source_twice() -> None:
    program = "import sys; print(sys.dont_write_bytecode)"
    started = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert not sys.dont_write_bytecode
    assert started.stdout.strip() == "False"
