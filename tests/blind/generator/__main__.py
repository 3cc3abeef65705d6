"""python -m tests.blind.generator telescope FOLDER: writes the sample campaign."""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.blind.generator.telescope import write_telescope


def main() -> None:
    """Writes the named campaign into a folder, and the truth beside it."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.generator", description=main.__doc__)
    parser.add_argument("campaign", choices=["telescope"])
    parser.add_argument("folder", type=Path)
    write_telescope(parser.parse_args().folder)


if __name__ == "__main__":
    main()
