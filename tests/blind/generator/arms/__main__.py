"""python -m tests.blind.generator.arms FOLDER --count N --seed S: writes campaigns of arms with hidden effects."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tests.blind.generator.arms.draw import draw
from tests.blind.generator.arms.effects import CAUSES
from tests.blind.generator.arms.folder import write
from tests.blind.generator.arms.geometry import NOTATIONS
from tests.blind.generator.arms.instrument import BOTH, INSTRUMENTS
from tests.blind.generator.arms.layouts import LAYOUTS


def main(arguments: Sequence[str] | None = None) -> None:
    """Writes FOLDER/arm-SEED, and the truth next to it, for each of N seeds from S on."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.generator.arms", description=main.__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cause", action="append", choices=[*CAUSES, "none"], help="repeat for two at once")
    parser.add_argument("--layout", choices=LAYOUTS)
    parser.add_argument("--notation", choices=NOTATIONS)
    parser.add_argument("--instrument", choices=[*INSTRUMENTS, BOTH, "points"])
    parser.add_argument("--strength", type=float, default=10.0)
    parser.add_argument("--foreign", action="store_true")
    asked = parser.parse_args(arguments)
    causes = None if asked.cause is None else tuple(cause for cause in asked.cause if cause != "none")
    for seed in range(asked.seed, asked.seed + asked.count):
        campaign = draw(
            seed,
            layout=asked.layout,
            instrument=asked.instrument,
            causes=causes,
            strength=asked.strength,
            foreign=asked.foreign,
            notation=asked.notation,
        )
        write(campaign, asked.folder / f"arm-{seed:04d}")


if __name__ == "__main__":
    main()
