"""Chains with loops: a delta robot by a lab's own closure, and campaigns of it that share no code with truing."""

from __future__ import annotations

import sys
from pathlib import Path

# Where a lab's package would be installed: its entry points name the closure.
PACKAGE = str(Path(__file__).with_name("package"))
if PACKAGE not in sys.path:
    sys.path.append(PACKAGE)
