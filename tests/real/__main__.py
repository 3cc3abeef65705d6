"""``python -m tests.real``: run every campaign on real measurements and write docs/real-data.md."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.real.campaigns import data_folder, run_all, tables_of
from tests.real.facts import FACTS
from tests.real.figures import write_figures
from tests.real.page import PAGE, render
from tests.real.raw_facts import drawn_signals, raw_facts


def main() -> int:
    if not data_folder().is_dir():
        sys.stderr.write(f"no real measurements in {data_folder()}; TRUING_REAL_DATA names their folder\n")
        return 4
    with tempfile.TemporaryDirectory() as folder:
        sys.stdout.write(f"{', '.join(FACTS)}\n")
        run_all(tuple(FACTS), Path(folder))
        facts = {name: FACTS[name](tables) for name, tables in tables_of(tuple(FACTS), Path(folder)).items()}
    raw = raw_facts(data_folder())
    PAGE.write_text(render(facts, raw), encoding="utf-8")
    write_figures(facts, raw, drawn_signals(data_folder()))
    sys.stdout.write(f"{PAGE}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
