"""The checks of an axis' rows, by their names in qa.parquet."""

from __future__ import annotations

from truing.schemas.quality_check import Checks, Limits, QualityCheck, Rule

OF_AXES: Checks = {
    "axis-units": QualityCheck(
        "Does each encoder move as far as the command?",
        "Another unit, a turned sign or wrong counts per unit would be stated as an error of the axis.",
        Rule("ratio of the movements outside 0.9 to 1.1", "a ratio as of another unit or a sign, or outside 0.5 to 2"),
        "Mend the column's unit in the mapping, counts_per_deg or counts_per_mm, or the name in [mechanism].",
        withholds="models",
    ),
    "axis-standing-rows": QualityCheck(
        "Does an encoder keep its reading, to the last digit, while the command moves?",
        "A frozen or copied reading is stated as an error that follows the command.",
        Limits("share of the moves", warn=0.0, fail=0.1, most=1.0),
        "Look at the rows that are named: was the axis disabled, the encoder lost, or a cell filled down?",
        withholds="models",
    ),
    "axis-repeated-rows": QualityCheck(
        "Are rows equal to an earlier row in every encoder's last digit?",
        "Copied rows count as repeats that nobody measured, and make the noise look small.",
        Limits("rows beyond those that readings of so few digits repeat by chance", warn=0.0),
        "Take out the copies. Where an encoder resolves no more, state its step in [noise].",
    ),
    "axis-approach": QualityCheck(
        "Were rows approached from both sides?",
        "Lost motion shows only between two directions of approach.",
        Limits("share of the rarer direction", warn=0.1, below=True, most=0.5),
        "Measure the same commands coming from the other side.",
    ),
}
