"""Write every broken campaign into a folder: ``python -m tests.broken DIR``."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.broken.cases import CASES, write_broken

for case in CASES:
    write_broken(case, Path(sys.argv[1]) / case.name)
