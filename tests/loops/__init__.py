"""Chains with loops: a delta robot with a laboratory's own closure, and independent campaigns of it."""

from __future__ import annotations

import sys
from pathlib import Path

# Where a lab's package would be installed: its entry points name the closure.
PACKAGE = str(Path(__file__).with_name("package"))
if PACKAGE not in sys.path:
    sys.path.append(PACKAGE)
