"""Campaigns of serial arms drawn at random, with effects hidden in them; shares no code with ``truing``.

``draw`` draws a campaign, ``write`` writes its folder and the truth next to it. Inside, lengths are metres and angles
radians; in files, as each column's name says.
"""

from tests.blind.generator.arms.draw import ArmCampaign, draw
from tests.blind.generator.arms.effects import CAUSES
from tests.blind.generator.arms.folder import truth, write
from tests.blind.generator.arms.instrument import INSTRUMENTS
from tests.blind.generator.arms.layouts import LAYOUTS

__all__ = ["CAUSES", "INSTRUMENTS", "LAYOUTS", "ArmCampaign", "draw", "truth", "write"]
