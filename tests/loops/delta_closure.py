"""The closure class of docs/own-loops.md, as a laboratory's package."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from truing.simulation.mechanisms.chains.closed_tree import LoopClosure

_PAGE = (Path(__file__).resolve().parents[2] / "docs" / "own-loops.md").read_text(encoding="utf-8")
(_CODE,) = re.findall(r"^`delta_loops.py`\n\n```python\n(.*?)```", _PAGE, re.M | re.S)
_names: dict[str, Any] = {"__name__": __name__}
exec(_CODE, _names)
Delta: type[LoopClosure] = _names["Delta"]
