"""The class of docs/own-loops.md, as a lab's package holds it."""

from __future__ import annotations

import re

from tests.conftest import PROJECT
from truing.simulation.mechanisms.chains.closed_tree import LoopClosure

_PAGE = (PROJECT / "docs" / "own-loops.md").read_text(encoding="utf-8")
(_CODE,) = re.findall(r"^`delta_loops.py`\n\n```python\n(.*?)```", _PAGE, re.M | re.S)
_names: dict[str, type[LoopClosure]] = {}
exec(_CODE, _names)
Delta = _names["Delta"]
