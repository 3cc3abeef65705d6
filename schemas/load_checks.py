"""The checks of a loading campaign on a bench, by their names in qa.parquet."""

from __future__ import annotations

from truing.schemas.quality_check import TEMPERATURE_UNIT, CheckLimits, Checks, QualityCheck, VerdictRule, time_unit

_OF_PROGRAMME: Checks = {
    "overruled": QualityCheck(
        "What does each [[exclude]], [[keep]] and [[accept]] name, and how many readings or verdicts is that?",
        "A rule with a mistyped name does nothing, in silence.",
        VerdictRule(warns="one that names nothing that was read, or no verdict"),
        "Correct the name in the entry that is told, or take the entry out.",
    ),
    "steps-missing": QualityCheck(
        "Which numbers do the steps of a run leave out?",
        "A lost step is lost history: creep and hysteresis know of loads that no row tells.",
        CheckLimits("share of the steps missing", warn=0.0, fail=0.3, most=1.0),
        "Look for the step in the instrument's own log; repeat the run where it is not there.",
    ),
    "runs-cut-short": QualityCheck(
        "Which runs end before others like them?",
        "A run without its end shows neither its return to zero nor its largest load.",
        VerdictRule(warns="any"),
        "Repeat the run that is named, or say in your notes why it ended.",
    ),
    "completeness": QualityCheck(
        "Which share of a channel's readings is missing, in the runs that it was watched in?",
        "A beam that was lost under large loads leaves out what matters most.",
        CheckLimits("share of the readings missing", warn=0.1, fail=0.3, most=1.0),
        "Align the beam over the whole range and repeat the run. A channel that was never read is not evaluated.",
    ),
    "time-gaps": QualityCheck(
        "How long is the longest pause within a run, over the usual pace?",
        "Zeros and temperatures may have moved meanwhile.",
        CheckLimits("longest pause over the usual", warn=10.0, unit="times"),
        "Repeat the run without a pause, or begin a new one after it. Not evaluated: times are not recorded, or merely "
        "count the steps.",
    ),
    "time-unit": time_unit("step"),
    "load-range": QualityCheck(
        "How large is the largest load, over the range in [loading]?",
        "Beyond the largest load everything is extrapolated. (Beyond 1 `ingest` refuses the load, unless "
        "`[loading] overload` declares an overload test.)",
        CheckLimits("largest load over the range", warn=0.5, below=True, most=1.0),
        "Load further, or declare the range that the sensor is used in.",
    ),
}
_OF_READINGS: Checks = {
    "units": QualityCheck(
        "Are readings 1000 times too large or small, off by another factor between units, or by 20 from the simulated?",
        "The mistake would be given a cause as large as itself; the diagnosis leaves such a campaign alone.",
        VerdictRule(fails="any run and channel"),
        "Mend the unit in the table or in its mapping, of the channel or of the load.",
        withholds="models",
    ),
    "signs": QualityCheck(
        "Does a run answer with the opposite sign, in its readings or its signals?",
        "A turned sign is a label and no property of the platform; the diagnosis leaves such a campaign alone.",
        VerdictRule(fails="any, beyond chance"),
        "Was the load or the channel turned? Mend the table or its mapping.",
        withholds="models",
    ),
    "channels-exchanged": QualityCheck(
        "Do channels of a run read what another of them should?",
        "Exchanged labels look like crosstalk; the diagnosis leaves such a campaign alone.",
        VerdictRule(fails="any"),
        "Compare the run's wiring with its table; a load written down for another axis looks the same.",
        withholds="models",
    ),
    "run-zeros": QualityCheck(
        "Do runs begin at zero without load, but for the noise of two readings, as a run counts from its own start?",
        "A run that was begun without setting its channels to zero carries what went before.",
        VerdictRule(
            warns="beyond chance (1e-4), or one run beyond 6 sigma, unless the starts follow a recorded column",
        ),
        "Set the channels to zero before each run. Runs are taken to count from zeros of their own, and are diagnosed.",
    ),
    "gross-errors": QualityCheck(
        "How many single readings are far from their place?",
        "A few are ordinary and left out; many say that the beam or the log is faulty.",
        CheckLimits("share of the readings far from their place", warn=0.05, fail=0.15, most=1.0),
        "Look at the runs and steps that are named; repeat the run.",
    ),
    "noise": QualityCheck(
        "How large is the scatter of a channel, over the declared noise?",
        "Every uncertainty rests on the declared noise; ten per cent off is ordinary.",
        VerdictRule(
            "beyond 1.1 times either way, beyond chance; signals beyond 100 times either way",
            "beyond 2 times either way, beyond chance",
        ),
        "Declare what the channel does, or find what shakes: air along the beam, the table, the load's suspension.",
    ),
    "jumps": QualityCheck(
        "Does a channel jump within a run and stay there?",
        "A miscounted fringe or a touched mirror shifts all that follows; the platform never jumps at equal loads.",
        VerdictRule(warns="any, beyond chance at its share"),
        "Look what happened before the step that is named; repeat the run.",
    ),
    "drift": QualityCheck(
        "Does a channel's zero walk over a run?",
        "What walks with time is taken for creep, or hides it.",
        VerdictRule(warns="beyond 3 sigma and beyond chance"),
        "Let bench and air settle; load in both orders, so that time and load can be told apart. Not evaluated: no "
        "walk is seen, and times merely count the steps.",
    ),
    "zero-return": QualityCheck(
        "Where does a channel stand without load after a run, against before?",
        "A zero that stays away tells of creep, play or slip, or that somebody touched the bench.",
        VerdictRule(warns="beyond chance"),
        "Wait without load and read again: what comes back is creep, what stays is slip.",
    ),
    "repeatability": QualityCheck(
        "How far apart are runs of the same loads in the same order, over the declared noise?",
        "It is the only direct witness that the declared noise is true from run to run.",
        VerdictRule(warns="beyond 1.5 times, beyond chance; programmes that scatter differently (p < 0.001)"),
        "Look what differed: seat of the load, temperature, preload. Not evaluated: repeat one run of each axis.",
    ),
}
_OF_SURROUNDINGS: Checks = {
    "surroundings": QualityCheck(
        "Are temperatures from -10 to 50 °C and pressures from 600 to 1100 hPa?",
        "Other values are another unit, and would be compensated for as they stand.",
        VerdictRule(fails="any outside"),
        "Mend the unit in the table or in its mapping; read the sensor beside another one.",
        withholds="models",
    ),
    "temperature-unit": TEMPERATURE_UNIT,
    "temperature-span": QualityCheck(
        "How far did a temperature walk within a run; is it missing in some steps?",
        "Beams and material follow it, and load follows time within a run.",
        CheckLimits("span within a run", warn=2.0, unit="K"),
        "Wait for the room, shorten the runs. Missing values warn whatever the limit: record them at each step.",
    ),
    "pressure-span": QualityCheck(
        "How far did the air's pressure walk within a run; is it missing in some steps?",
        "The wavelength follows it, by 0.27 ppm each hPa.",
        CheckLimits("span within a run", warn=10.0, unit="hPa"),
        "Shorten the runs. Missing values warn whatever the limit: record them at each step.",
    ),
    "worth-of-air": QualityCheck(
        "What is the air's change within a run worth in readings, over dead path and displacement?",
        "Where readings came compensated, nobody can tell for which air.",
        CheckLimits("worth over the noise, where readings came compensated", warn=3.0, unit="sigma"),
        "Shorten the dead path, or log uncompensated readings with the air beside them.",
    ),
    "corrections": QualityCheck(
        "What does a correction for air or material leave uncertain, where its sigmas are declared?",
        "Known less well than the channel reads, it decides over the result ([interferometer](interferometer.md)).",
        CheckLimits("uncertainty over the channel's noise", warn=1.0),
        "Calibrate the sensor of temperature or pressure, or measure dead path or expansion better.",
    ),
}
_OF_SIGNALS: Checks = {
    "signals": QualityCheck(
        "Does the campaign hold signals?",
        "Without them it says how the platform moves, and nothing of what the sensor would read.",
        VerdictRule(),
        "Nothing, where only the platform was measured; never warns or fails.",
    ),
    "saturated": QualityCheck(
        "Do samples stand at `[signals] range_mv`, or meet an end of a signal's range as a wall?",
        "A cut sample reads the same at different loads: the calibration would bend toward it.",
        VerdictRule(fails="any"),
        "Lower the amplifier's gain or the load and repeat the steps that are named; or exclude them.",
    ),
    "loads-span": QualityCheck(
        "Do the loads tell all components of the wrench apart?",
        "A component that was never loaded, or only together with another, cannot be calibrated.",
        VerdictRule("an axis that was never loaded", "axes that were loaded, but only together"),
        "Load the direction that is named (`truing design CAMPAIGN` proposes loads).",
    ),
    "signals-independent": QualityCheck(
        "Do the signals hold as many independent numbers as the loads (has V Vᵀ an inverse)?",
        "A dead or doubled channel leaves a component of the load unseen.",
        VerdictRule("singular but for noise", "singular"),
        "Look at the channels of the combination that is named: wiring, bridge, amplifier.",
    ),
    "exchanged-rows": QualityCheck(
        "Do the loads of two rows stand in each other's place, by their signals?",
        "Two exchanged rows spoil a calibration as much as a gross error each.",
        VerdictRule(fails="any, beyond chance"),
        "Compare the rows that are named with the protocol, and exchange their loads.",
    ),
    "signals-round": QualityCheck(
        "How far does the radius of an interferometer's raw signals scatter once corrected, over the radius?",
        "What is not round is a periodic error of every reading; samples cut by the converter do that.",
        CheckLimits("scatter of the radius over the radius", fail=0.01, most=1.0),
        "Align the beam, lower the gain so that nothing is cut, and record the run anew.",
    ),
    "fringes-counted": QualityCheck(
        "How likely was any step from sample to sample counted a fringe off?",
        "One miscounted fringe shifts all readings after it.",
        CheckLimits("largest probability of a step", fail=1e-3, most=1.0),
        "Load more slowly or sample faster, and record the run anew.",
    ),
}
_OF_BELONGING: Checks = {
    "loads-against-readings": QualityCheck(
        "Do the readings follow the loads as the simulation predicts, and in every run as in the others?",
        "A unit, a sign or a label that was mistaken is taken for a stiffness; nothing that rests on it is evaluated.",
        VerdictRule(
            "no slip explains it, and a run answers more than twice, or less than half, of what is expected",
            "a slip explains more than every physical cause could, or half of all responses are off by a factor of 3",
        ),
        "Mend the table or its mapping as the sentence proposes. Not tested: give [mechanism] elements or "
        "compliance_file, or load each axis in three runs.",
        withholds="models",
    ),
    "signals-against-loads": QualityCheck(
        "Do the signals follow the loads by the legs' geometry, the declared gain, and in every run as in the others?",
        "A calibration takes a unit, a sign, an exchange or a shift of rows for the sensor's own.",
        VerdictRule(fails="a slip explains more than every physical cause could"),
        "Mend the table or its mapping as the sentence proposes. Not tested: load each axis in three runs, or declare "
        "[mechanism] and [signals] sensitivity_mv_per_n.",
        withholds="models",
    ),
    "copied-runs": QualityCheck(
        "Does a run hold the very numbers of another one?",
        "Noise makes no two runs equal: one of them was never measured.",
        VerdictRule(fails="any pair, beyond chance"),
        "Find the run's own data in the instrument's log, or exclude it.",
        withholds="models",
    ),
}
OF_LOADS: Checks = {**_OF_BELONGING, **_OF_PROGRAMME, **_OF_READINGS, **_OF_SURROUNDINGS, **_OF_SIGNALS}
