"""The checks of an axis by their names in qa.parquet: of its rows, and of its positioning runs."""

from __future__ import annotations

from truing.schemas.quality_check import CheckLimits, Checks, QualityCheck, VerdictRule

OF_AXES: Checks = {
    "axis-units": QualityCheck(
        "Does each encoder move as far as the command?",
        "Another unit, a turned sign or wrong counts per unit would be stated as an error of the axis.",
        VerdictRule(
            "ratio of the movements outside 0.9 to 1.1", "a ratio as of another unit or a sign, or outside 0.5 to 2"
        ),
        "Mend the column's unit in the mapping, counts_per_deg or counts_per_mm, or the name in [mechanism].",
        withholds="models",
    ),
    "axis-standing-rows": QualityCheck(
        "Does an encoder keep its reading, to the last digit, while the command moves?",
        "A frozen or copied reading is stated as an error that follows the command.",
        CheckLimits("share of the moves", warn=0.0, fail=0.1, most=1.0),
        "Look at the rows that are named: was the axis disabled, the encoder lost, or a cell filled down?",
        withholds="models",
    ),
    "axis-repeated-rows": QualityCheck(
        "Are rows equal to an earlier row in every encoder's last digit?",
        "Copied rows count as repeats that nobody measured, and make the noise look small.",
        CheckLimits("rows beyond those that readings of so few digits repeat by chance", warn=0.0),
        "Take out the copies. Where an encoder resolves no more, state its step in [noise].",
    ),
    "axis-approach": QualityCheck(
        "Were rows approached from both sides?",
        "Lost motion shows only between two directions of approach.",
        CheckLimits("share of the rarer direction", warn=0.1, below=True, most=0.5),
        "Measure the same commands coming from the other side.",
    ),
}

OF_POSITIONS: Checks = {
    "positions-against-targets": QualityCheck(
        "Do the positions of a run follow the targets that they stand beside?",
        "Another unit, a turned sign, deviations in place of positions or shifted rows would be stated as accuracy.",
        VerdictRule(
            "rms misfit above 1 % of the travel", "a slip that explains the misfit, or above 5 % of the travel"
        ),
        "Mend the table or its mapping: unit, sign, column or row.",
    ),
    "encoder-overflow": QualityCheck(
        "Do deviations differ by 2^n steps of the reading, with n from 8 to 40?",
        "A counter that overflowed puts all later positions elsewhere by a whole range.",
        VerdictRule(fails="any"),
        "Add the overflow to the positions that are named, or record the run anew with a wider counter.",
    ),
    "position-jumps": QualityCheck(
        "Do positions stand elsewhere from some row on, or in two groups far apart other than by direction?",
        "Cycles before and after a jump, or a target that was written down wrongly, do not belong to one test.",
        CheckLimits("step over the scatter, or gap over the range of the wider group", fail=10.0),
        "Was the instrument set to zero anew, or is the target wrong that is named? Mend it, or record the run anew.",
    ),
    "position-errors": QualityCheck(
        "Is an approach far from the others of its target and direction?",
        "One gross error decides over repeatability and accuracy, which are extremes.",
        VerdictRule("beyond chance (1e-3)", "beyond chance and beyond 10 times the scatter"),
        "Look at the row that is named: a mistyped digit, a lost beam, an approach that did not settle.",
    ),
    "copied-approaches": QualityCheck(
        "Are series of approaches equal in every digit, or does the reading stand still while the axis moves?",
        "Copied or frozen readings make an axis look repeatable that nobody measured.",
        VerdictRule(fails="any, beyond chance for readings of so few digits"),
        "Find the readings of the series that is named. Where the reading is coarser than the axis, use a finer one.",
    ),
    "approach-directions": QualityCheck(
        "Are forward and backward the sides that the axis came from, in every cycle?",
        "Exchanged directions turn the reversal round, and widen both repeatabilities where it is a single cycle.",
        VerdictRule("all of a run against the order of its rows", "single cycles against the others"),
        "Exchange forward and backward where the message says so. Not evaluated: the order of the rows does not show "
        "how the axis moved; write them in the order taken.",
    ),
    "approach-cycles": QualityCheck(
        "How often was every target approached from either side?",
        "ISO 230-2 asks for five cycles; scatter of fewer is hardly known.",
        CheckLimits("cycles", warn=5.0, below=True),
        "Record five cycles; the interval beside each figure says what fewer leave open.",
    ),
    "position-drift": QualityCheck(
        "Do the deviations walk from cycle to cycle?",
        "Warming up counts as repeatability; ISO 230-2 asks for a run that is steady.",
        VerdictRule(warns="beyond chance (1e-4), and nine tenths of it a straight walk"),
        "Run the axis warm before the test, and correct for its temperature.",
    ),
    "axis-temperature": QualityCheck(
        "Is the axis' temperature from -10 to 50 °C?",
        "Positions are brought to 20 °C by it; another unit stretches the axis.",
        VerdictRule(fails="any outside"),
        "Mend the unit in the table or in its mapping.",
    ),
}
