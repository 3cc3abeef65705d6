"""Checks of an axis by their names in qa.parquet: its rows, and its positioning runs."""

from __future__ import annotations

from truing.schemas.quality_check import TEMPERATURE_UNIT, CheckLimits, Checks, QualityCheck, VerdictRule

OF_AXES: Checks = {
    "axis-units": QualityCheck(
        "Does each encoder move as far as the command?",
        "A wrong unit, sign or number of counts per unit would appear as an axis error.",
        VerdictRule(
            "ratio of the movements outside 0.9 to 1.1",
            "a ratio that another unit or sign, or exchanged columns explain, or outside 0.5 to 2; exact values of "
            "commands in an encoder's column",
        ),
        "Correct the column's unit in the mapping, counts_per_deg or counts_per_mm, or the name in [mechanism].",
        withholds="models",
    ),
    "axis-rows": QualityCheck(
        "Does every reading belong to the command of its row?",
        "Rows that were exchanged, shifted, sorted, copied or written in another unit would appear as errors of the "
        "axis.",
        VerdictRule(
            "at most a tenth of the rows off by more than 2 % of the travel",
            "more rows; rows that an exchange, a shift, another order, unit or sign explains (a shifted zero is none); "
            "a stretch or a column that equals another in every digit",
        ),
        "Correct the named rows in the export or its mapping, or exclude them.",
        withholds="models",
    ),
    "axis-standing-rows": QualityCheck(
        "Does an encoder repeat its reading, to the last digit, while the command moves?",
        "A frozen or copied reading would appear as an error that follows the command.",
        CheckLimits("share of the moves", warn=0.0, fail=0.1, most=1.0),
        "Inspect the named rows: was the axis disabled, the encoder lost, or a cell filled down?",
        withholds="models",
    ),
    "axis-repeated-rows": QualityCheck(
        "Does a row equal an earlier row in every encoder's last digit?",
        "Copied rows count as repeats and make the noise look small.",
        CheckLimits("repeated rows beyond those expected by chance at this resolution", warn=0.0),
        "Delete the copies. If an encoder resolves no more, state its step in [noise].",
    ),
    "axis-noise": QualityCheck(
        "Is the scatter of an encoder smaller than its declared noise and that of the command allow?",
        "Too large a declared noise hides small effects. Scatter: between neighbouring commands from one side.",
        VerdictRule("significantly below 1/1.5 times"),
        "Declare the encoder's and the command's real noise in [noise]. Larger scatter is tested by adequacy, with the "
        "final model.",
    ),
    "axis-encoders": QualityCheck(
        "Does the outside instrument agree with the load encoder, and the encoder of the loop with the command?",
        "Exchanged columns of motor and load, or a wrong loop, would appear as errors of the instrument.",
        VerdictRule(
            "the instrument agrees with the motor, and the other encoder follows the command, significantly; without "
            "an instrument: the other encoder follows the command better, significantly",
            "the same, and the encoder of the loop departs from the command three times as far as the other, or as the "
            "instrument",
        ),
        "Correct loop in [mechanism], or exchange the columns.",
        withholds="models",
    ),
    "axis-approach": QualityCheck(
        "Were rows approached from both sides?",
        "Lost motion appears only between two directions of approach.",
        CheckLimits("share of the rarer direction", warn=0.1, below=True, most=0.5),
        "Measure the same commands from the other side.",
    ),
    "temperature-unit": TEMPERATURE_UNIT,
}

OF_POSITIONS: Checks = {
    "positions-against-targets": QualityCheck(
        "Do the positions of a run follow the targets in their rows?",
        "A wrong unit or sign, deviations instead of positions, or shifted rows would appear as accuracy.",
        VerdictRule(
            "rms misfit above 1 % of the travel, or a span below 0.05 ppm of it",
            "a slip that explains the misfit, or above 5 % of the travel",
        ),
        "Correct the table or its mapping: unit, sign, column or row.",
    ),
    "encoder-overflow": QualityCheck(
        "Do deviations differ by 2^n reading steps, with n from 8 to 40?",
        "A counter overflow shifts all later positions by a whole range.",
        VerdictRule(fails="any"),
        "Add the overflow to the named positions, or repeat the run with a wider counter.",
    ),
    "position-jumps": QualityCheck(
        "Do positions shift from some row on, or form two distant groups that direction does not explain?",
        "Cycles before and after a jump do not belong to one test.",
        CheckLimits("step over the scatter, or gap over the range of the wider group", fail=10.0),
        "Was the instrument zeroed again, or is the named target wrong? Correct it, or repeat the run.",
    ),
    "position-errors": QualityCheck(
        "Is an approach far from others of the same target and direction?",
        "One gross error decides repeatability and accuracy, because both are extremes.",
        VerdictRule("significant (1e-3)", "significant and above 10 times the scatter"),
        "Inspect the named row: a mistyped digit, a lost beam, an approach that did not settle.",
    ),
    "copied-approaches": QualityCheck(
        "Are series of approaches equal in every digit, or is the reading constant while the axis moves?",
        "Copied or frozen readings make an axis look repeatable.",
        VerdictRule(fails="any, unlikely by chance at this resolution"),
        "Find the readings of the named series. If the reading is coarser than the axis, use a finer one.",
    ),
    "approach-directions": QualityCheck(
        "Do forward and backward match the side of approach, in every cycle?",
        "Exchanged directions invert the reversal; in a single cycle they widen both repeatabilities.",
        VerdictRule("a whole run against the order of its rows", "single cycles against the others"),
        "Exchange forward and backward as the message says.",
        not_evaluated="the order of the rows does not show the movement; write rows in the order taken",
    ),
    "approach-cycles": QualityCheck(
        "How often was every target approached from each side?",
        "ISO 230-2 requires five cycles; fewer give an uncertain scatter.",
        CheckLimits("cycles", warn=5.0, below=True),
        "Record five cycles; the interval of each figure shows the effect of fewer.",
    ),
    "position-drift": QualityCheck(
        "Do the deviations drift from cycle to cycle?",
        "Warming up counts as repeatability; ISO 230-2 requires a steady state.",
        VerdictRule(warns="significant (1e-4), and nine tenths of it linear"),
        "Warm the axis up before the test, and correct for its temperature.",
    ),
    "axis-temperature": QualityCheck(
        "Is the axis temperature from -10 to 50 °C?",
        "Positions are corrected to 20 °C with it; another unit scales the axis.",
        VerdictRule(fails="any outside"),
        "Correct the unit in the table or its mapping.",
    ),
}
