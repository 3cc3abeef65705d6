"""Checks of a loading campaign on a bench, by their names in qa.parquet."""

from __future__ import annotations

from truing.schemas.quality_check import TEMPERATURE_UNIT, CheckLimits, Checks, QualityCheck, VerdictRule, time_unit

_OF_PROGRAMME: Checks = {
    "overruled": QualityCheck(
        "How many readings or verdicts does each [[exclude]], [[keep]] and [[accept]] match?",
        "An entry with a mistyped name does nothing.",
        VerdictRule(warns="an entry that matches none"),
        "Correct the name in the entry, or delete the entry.",
    ),
    "steps-missing": QualityCheck(
        "Which step numbers does a run lack?",
        "Creep and hysteresis depend on every load, also on one without a row.",
        CheckLimits("share of the steps missing", warn=0.0, fail=0.3, most=1.0),
        "Look for the step in the instrument's log; else repeat the run.",
    ),
    "runs-cut-short": QualityCheck(
        "Which runs end before similar runs?",
        "Such a run lacks its return to zero, and perhaps its largest load.",
        VerdictRule(warns="any"),
        "Repeat the named run, or note why it ended.",
    ),
    "completeness": QualityCheck(
        "What share of a channel's readings is missing, in the runs that record it?",
        "A beam lost under large loads removes the most important readings.",
        CheckLimits("share of the readings missing", warn=0.1, fail=0.3, most=1.0),
        "Align the beam over the whole range and repeat the run.",
        not_evaluated="a channel without readings",
    ),
    "time-gaps": QualityCheck(
        "How long is the longest pause within a run, relative to the usual interval?",
        "Zeros and temperatures may have changed meanwhile.",
        CheckLimits("longest pause over the usual interval", warn=10.0, unit="times"),
        "Repeat the run without a pause, or start a new run after it.",
        not_evaluated="times are missing, or only count steps",
    ),
    "time-unit": time_unit("step"),
    "load-range": QualityCheck(
        "How large is the largest load, relative to the range in [loading]?",
        "Results beyond the largest load are extrapolated.",
        CheckLimits("largest load over the range", warn=0.5, below=True, most=1.0),
        "Apply larger loads, or declare the range of use. `ingest` refuses loads above 1, except in an overload test "
        "(`[loading] overload`).",
    ),
}
_OF_READINGS: Checks = {
    "units": QualityCheck(
        "Are readings wrong by 1000, by another factor between units, or by 20 from the simulation?",
        "The diagnosis would assign a cause of the same size.",
        VerdictRule(fails="any run and channel"),
        "Correct the unit of the channel or of the load, in the table or its mapping.",
        withholds="models",
    ),
    "signs": QualityCheck(
        "Does a run respond with the opposite sign, in its readings or its signals?",
        "The diagnosis would take a wrong sign for a property of the platform.",
        VerdictRule(fails="any significant run"),
        "Was the load or the channel reversed? Correct the table or its mapping.",
        withholds="models",
    ),
    "channels-exchanged": QualityCheck(
        "Does a channel of a run record what another channel should?",
        "Exchanged labels look like crosstalk.",
        VerdictRule(fails="any"),
        "Compare the run's wiring with its table; a load recorded for another axis looks the same.",
        withholds="models",
    ),
    "run-zeros": QualityCheck(
        "Do runs begin at zero without load, within the noise of two readings?",
        "A run whose channels were not set to zero includes earlier displacements.",
        VerdictRule(
            warns="significant (1e-4), or one run above 6 sigma, unless the starts follow a recorded column",
        ),
        "Set the channels to zero before each run. The diagnosis estimates a zero for each run.",
    ),
    "gross-errors": QualityCheck(
        "How many single readings are gross errors?",
        "A few are normal and left out. Many indicate a faulty beam or log.",
        CheckLimits("share of gross errors", warn=0.05, fail=0.15, most=1.0),
        "Inspect the named runs and steps; repeat the run.",
    ),
    "noise": QualityCheck(
        "How large is the scatter of a channel, over the declared noise?",
        "Every uncertainty uses the declared noise; a deviation of 10 % is normal.",
        VerdictRule(
            "significantly above 1.1 times or below 1/1.1; signals above 100 times or below 1/100; more under combined "
            "loads, where it follows their products or stays below 2 % of the response",
            "significantly above 2 times or below 1/2",
        ),
        "Declare the channel's real noise, or find the disturbance: air along the beam, table, suspension of the load.",
    ),
    "jumps": QualityCheck(
        "Does a channel jump within a run and stay there?",
        "A miscounted fringe or a touched mirror shifts all later readings; the platform never jumps at equal loads.",
        VerdictRule(warns="any significant jump"),
        "Find out what happened before the named step; repeat the run.",
    ),
    "drift": QualityCheck(
        "Does a channel's zero drift over a run?",
        "A drift looks like creep, or hides it.",
        VerdictRule(warns="above 3 sigma and significant"),
        "Let bench and air settle; load in both orders to separate time from load.",
        not_evaluated="no drift is seen, and times only count steps",
    ),
    "zero-return": QualityCheck(
        "Where is a channel without load after a run, compared with before?",
        "A zero that does not return indicates creep, play or slip, or a touched bench.",
        VerdictRule(warns="significant"),
        "Wait without load and read again: creep recovers, slip remains.",
    ),
    "repeatability": QualityCheck(
        "How large is the scatter between runs of equal loads in equal order, over the declared noise?",
        "Only repeats show that the declared noise holds from run to run.",
        VerdictRule(warns="significantly above 1.5 times; programmes that scatter differently (p < 0.001)"),
        "Find what differed: seat of the load, temperature, preload.",
        not_evaluated="repeat one run of each axis",
    ),
}
_OF_SURROUNDINGS: Checks = {
    "surroundings": QualityCheck(
        "Are temperatures from -10 to 50 °C, pressures from 600 to 1100 hPa and humidities above 1 %?",
        "Other values indicate another unit and would make the compensation wrong.",
        VerdictRule(
            warns="a humidity or pressure that looks like another unit", fails="a temperature or pressure outside"
        ),
        "Correct the unit in the table or its mapping; compare the sensor with another one.",
        withholds="models",
    ),
    "temperature-unit": TEMPERATURE_UNIT,
    "temperature-span": QualityCheck(
        "How much did a temperature change within a run; is it missing in some steps?",
        "Temperature changes beams and material, and within a run it cannot be separated from load.",
        CheckLimits("range within a run", warn=2.0, unit="K"),
        "Let the room settle; shorten the runs. Missing values always warn: record each step.",
    ),
    "pressure-span": QualityCheck(
        "How much did the air pressure change within a run; is it missing in some steps?",
        "The wavelength changes by 0.27 ppm per hPa.",
        CheckLimits("range within a run", warn=10.0, unit="hPa"),
        "Shorten the runs. Missing values always warn: record each step.",
    ),
    "worth-of-air": QualityCheck(
        "How much does the change of the air within a run change readings, over dead path and displacement?",
        "Compensated readings do not show which air they were compensated for.",
        CheckLimits("change over the noise, if readings are already compensated", warn=3.0, unit="sigma"),
        "Shorten the dead path, or log uncompensated readings together with the air.",
    ),
    "corrections": QualityCheck(
        "How uncertain is a correction for air or material, if its sigmas are declared?",
        "A correction less certain than the reading dominates the result ([interferometer](interferometer.md)).",
        CheckLimits("uncertainty over the channel's noise", warn=1.0),
        "Calibrate the temperature or pressure sensor, or measure dead path or expansion better.",
    ),
}
_OF_SIGNALS: Checks = {
    "signals": QualityCheck(
        "Does the campaign have signals?",
        "Without signals, it shows how the platform moves but not what the sensor would read.",
        VerdictRule(),
        "Nothing, if only the platform was measured; never warns or fails.",
    ),
    "saturated": QualityCheck(
        "Do samples lie at `[signals] range_mv`, or pile up at an end of a signal's range?",
        "A clipped sample reads the same at different loads and biases the calibration.",
        VerdictRule(fails="any"),
        "Lower the amplifier's gain or the load and repeat the named steps, or exclude them.",
    ),
    "steps-without-signals": QualityCheck(
        "Do load steps carry neither a signal nor a reading?",
        "Nothing was measured there: a load plan next to the same loads with signals counts every step twice.",
        VerdictRule("any"),
        "Take one of two files with the same loads out of campaign.toml, or put the signals next to their loads.",
    ),
    "loads-joined": QualityCheck(
        "Do signals belong to the rows of [files.loads] that they were joined to, and not to those before or after?",
        "Rows that are joined in a wrong order give each signal the load of another step.",
        VerdictRule("signals without loads", "the rows before or after fit clearly better"),
        "Compare the first and the last rows of both files, and their clocks; join by a column `step` that both have.",
        not_evaluated="too few load steps",
    ),
    "loads-span": QualityCheck(
        "Do the loads separate all components of the wrench?",
        "A component that is never loaded, or only together with another, cannot be calibrated.",
        VerdictRule("an axis without load", "axes loaded only together"),
        "Load the named direction (`truing design CAMPAIGN` proposes loads).",
    ),
    "signals-independent": QualityCheck(
        "Do the signals have as many independent components as the loads (is V Vᵀ invertible)?",
        "A dead or duplicated channel hides a component of the load.",
        VerdictRule("singular within noise", "singular"),
        "Inspect the named channels: wiring, bridge, amplifier.",
    ),
    "stray-loads": QualityCheck(
        "Do the signals of each row agree with its recorded load?",
        "One wrong digit of a load spoils a calibration, and looks like an error of the sensor.",
        VerdictRule(fails="a row differs by more than 20 sigma and 5 % of the range, and at most 2 % of the rows do"),
        "Compare the named rows with the protocol and correct the load, or exclude the row.",
    ),
    "exchanged-rows": QualityCheck(
        "Do the signals show that the loads of two rows are exchanged?",
        "Two exchanged rows harm a calibration like two gross errors.",
        VerdictRule(fails="any significant pair"),
        "Compare the named rows with the protocol, and exchange their loads.",
    ),
    "signals-round": QualityCheck(
        "How much does the radius of an interferometer's corrected raw signals scatter?",
        "A radius that is not constant gives a periodic error of every reading; clipped samples cause it.",
        CheckLimits("scatter of the radius over the radius", fail=0.01, most=1.0),
        "Align the beam, lower the gain until nothing is clipped, and repeat the run.",
    ),
    "fringes-counted": QualityCheck(
        "How likely is a miscounted fringe between two samples?",
        "One miscounted fringe shifts all later readings.",
        CheckLimits("largest probability of a step", fail=1e-3, most=1.0),
        "Load more slowly or sample faster, and repeat the run.",
    ),
}
_OF_BELONGING: Checks = {
    "loads-against-readings": QualityCheck(
        "Do the readings follow the loads as the simulation predicts, alike in every run?",
        "The diagnosis would take a wrong unit, sign or label for a stiffness.",
        VerdictRule(
            "a run responds more than twice, or less than half, as expected, and no slip explains it",
            "a slip explains more than any physical cause, or half of all responses are off by a factor of 3",
        ),
        "Correct the table or its mapping as the message proposes.",
        not_evaluated="give [mechanism] elements or compliance_file, or load each axis in three runs",
        withholds="models",
    ),
    "signals-against-loads": QualityCheck(
        "Do the signals follow the loads by leg geometry and declared gain, alike in every run?",
        "A calibration would absorb a wrong unit or sign, exchanged channels or shifted rows.",
        VerdictRule(fails="a slip explains more than any physical cause"),
        "Correct the table or its mapping as the message proposes.",
        not_evaluated="load each axis in three runs, or declare [mechanism] and [signals] sensitivity_mv_per_n",
        withholds="models",
    ),
    "copied-runs": QualityCheck(
        "Do two runs have identical numbers?",
        "Noise makes all measured runs different: one of them was never measured.",
        VerdictRule(fails="any significant pair"),
        "Find the run's own data in the instrument's log, or exclude it.",
        withholds="models",
    ),
}
OF_LOADS: Checks = {**_OF_BELONGING, **_OF_PROGRAMME, **_OF_READINGS, **_OF_SURROUNDINGS, **_OF_SIGNALS}
