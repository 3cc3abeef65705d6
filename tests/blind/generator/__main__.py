"""python -m tests.blind.generator telescope|force-sensor|robot FOLDER: writes a sample campaign."""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.blind.generator.arms.robot import write_robot
from tests.blind.generator.sensor.force_sensor import write_force_sensor
from tests.blind.generator.telescope import write_telescope

WRITERS = {"telescope": write_telescope, "force-sensor": write_force_sensor, "robot": write_robot}


def main() -> None:
    """Writes the named campaign into a folder, and the truth next to it."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.generator", description=main.__doc__)
    parser.add_argument("campaign", choices=sorted(WRITERS))
    parser.add_argument("folder", type=Path)
    asked = parser.parse_args()
    WRITERS[asked.campaign](asked.folder)


if __name__ == "__main__":
    main()
