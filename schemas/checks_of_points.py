"""The checks of a campaign of object points, by their names in qa.parquet."""

from __future__ import annotations

from truing.schemas.quality_check import Checks, Limits, QualityCheck, Rule

OF_POINTS: Checks = {
    "unobserved-poses": QualityCheck(
        "Of which configurations was no point measured?",
        "A pose that was not photographed is missing where it was planned to tell something; more often its points are "
        "there under another name.",
        Limits("share of the configurations without a point", warn=0.0, fail=0.3, most=1.0),
        "Compare the pose names of both tables; mend the mapping, measure the pose, or take its row out.",
    ),
    "attachment-labels": QualityCheck(
        "Does each target with a `leg` lie nearest to that leg's own nominal attachment?",
        "A target given to a wrong leg gives that leg the shift of another one.",
        Rule(fails="any that does not"),
        "Correct `leg` in targets.csv, or the order of the legs in [mechanism].",
        withholds="models",
    ),
    "completeness": QualityCheck(
        "Which share of a body's target readings is missing?",
        "What is hidden is rarely hidden at random: whole directions or poses lose their weight.",
        Limits("share of the target readings missing", warn=0.1, fail=0.3, most=1.0),
        "Look which targets and poses are missing; add camera stations, clean the targets, or repeat those poses.",
    ),
    "poses-determined": QualityCheck(
        "In how many poses has a body too few usable targets?",
        "Such a pose is lost to everything that follows.",
        Limits("share of the poses that cannot be determined", warn=0.05, fail=0.3, most=1.0),
        "Repeat the poses that are named; put targets where they stay visible.",
    ),
    "geometry": QualityCheck(
        "Has a body three targets that make its frame?",
        "With fewer, it has no orientation.",
        Rule(fails="fewer than three"),
        "Put more targets on it and survey it anew.",
    ),
    "geometry-line": QualityCheck(
        "How far do a body's targets spread across their longest axis?",
        "Targets in a line leave the roll about it free.",
        # Below it the roll is known to some 5 degrees at best.
        Limits("spread (rms) over the noise of a target", fail=5.0, below=True, unit="sigma"),
        "Put a target well off the line and survey the body anew.",
    ),
    "geometry-plane": QualityCheck(
        "How thick is a body of more than three targets, over its length?",
        "In a plane, labels that are mirrored fit as well as right ones, and go unnoticed.",
        Limits("thickness over length", warn=0.01, below=True),
        "Put one target out of the plane; else compare the labels with a photograph.",
    ),
    "geometry-leverage": QualityCheck(
        "Which share of a target's own error stays in the frame?",
        "A frame that hangs on one target moves with it, and its residual shows nothing.",
        Limits("share of the target's error that stays in the frame", warn=0.9, most=1.0),
        "Put a second target near to the one that is named.",
    ),
    "gross-errors": QualityCheck(
        "How many readings are far from their place, after a robust fit?",
        "A few are ordinary and left out; many say that labels, the survey or the targets themselves are wrong.",
        Limits("share of the readings far from their place", warn=0.05, fail=0.15, most=1.0),
        "Look at the targets that are named most often: loose, damaged, reflecting, or labelled wrongly? Not "
        "evaluated: fewer than three targets, or one pose without a survey.",
    ),
    "exchanged-labels": QualityCheck(
        "Do two targets lie on each other's places?",
        "Every figure that rests on them is wrong, and the mend is in the laboratory's hands.",
        Rule(fails="any pair"),
        "Exchange the labels in the poses that are named, in the instrument's project or in the export. Not evaluated: "
        "fewer than three targets, or one pose without a survey.",
    ),
    "moved-targets": QualityCheck(
        "Does a target sit elsewhere from some pose on?",
        "A sticker that was touched looks like a deformation. It can be modelled, and so does not gate.",
        Rule(warns="any, beyond chance at its share"),
        "Find out what happened before the pose that is named; survey the target anew, or exclude it by name. "
        "Not evaluated: no target is seen in six poses.",
    ),
    "resurvey": QualityCheck(
        "How far do targets lie from where they were surveyed before, where nothing takes that into account?",
        "A target that moved and was not noticed turns the body in all poses after. Those that lie elsewhere beyond "
        "chance are named, the common motion of the others taken out; one that holds anew from a pose on, or is "
        "excluded, passes.",
        Limits("shift of a target that moved beyond chance, over its sigma", warn=0.0, fail=10.0, unit="sigma"),
        "Say from which pose on the new place holds (`[[resurvey]] from_pose`; `moved-targets` tells when), or exclude "
        "the target by name.",
    ),
    "names-known": QualityCheck(
        "Does a name that the survey does not know lie at the place of a target that is missing there?",
        "Instruments number anew, and labels are replaced: such points are lost to the body as long as nobody says "
        "which target they are. Nothing is renamed by itself.",
        Rule(warns="any"),
        "Write the `[[renamed]]` that the report proposes, once you have looked. Not evaluated: no survey.",
    ),
    "points-against-survey": QualityCheck(
        "Are a body's points its survey, moved: not its mirror image, and in the same unit?",
        "A mirrored body or another unit fits nothing, and every later figure rests on it.",
        Rule(warns="beyond 10 sigma of a point, unexplained", fails="a mirror image or another unit explains it"),
        "Correct the axis, the unit or the names that the message names, in the export or in its mapping.",
        withholds="poses",
    ),
    "copied-poses": QualityCheck(
        "Is each pose a measurement of its own?",
        "Points that agree in every digit are a copy, or come from an instrument that stood still. Not evaluated where "
        "a single pose was measured, or the file's resolution is too coarse to tell.",
        Rule(fails="two poses the same in every digit"),
        "Export the poses that are named again; take out those that were not measured.",
        withholds="models",
    ),
    "legs-regular": QualityCheck(
        "Do the legs of [mechanism] hold the platform in all six directions?",
        "Parallel or otherwise singular legs leave a motion free: no readings say where the platform is.",
        Rule(fails="a motion that changes no leg"),
        "Compare a_mm, b_mm and u of [mechanism] with the drawing.",
        withholds="models",
    ),
    "readings-against-poses": QualityCheck(
        "Do actuator readings move as the measured poses and [mechanism] ask for?",
        "A unit, a sign, an exchanged column or a shifted row bends every parameter, and a matrix can swallow it. "
        "Plausible slips in readings, rows and description are tried; one counts if it beats all physical effects.",
        Rule(
            "misfit beyond 0.2 of the movement",
            "a slip explains the data, or the misfit is beyond 0.5 of the movement, of all legs or of one",
        ),
        "Undo the slip that the message names once you know it is true; else compare readings and poses one by one.",
        withholds="models",
    ),
    "noise": QualityCheck(
        "How large is the scatter per body, and per body and axis, over the declared noise?",
        "Every uncertainty and test rests on the declared noise. Ten per cent off is ordinary; the test is one-sided "
        "against the multiple, so that the share of false alarms holds just below it.",
        Rule(
            "beyond 1.1 times either way, beyond chance",
            "beyond 1.5 times, beyond chance; one axis beyond 2.5 times",
        ),
        "Declare what the instrument does (`[noise]`, sigma columns), or find what shakes: tripod, traffic, exposure.",
    ),
    "noise-by-pose": QualityCheck(
        "Which poses are noisier than the body's ordinary scatter?",
        "One is a pose to look at: something moved while it was taken. Many are no campaign.",
        Rule("any beyond 1.5 times, at one in a million", "beyond 3 times in a tenth of the poses, beyond chance"),
        "Repeat the pose that is named; let the machine settle before each pose.",
    ),
    "base-drift": QualityCheck(
        "Does the reference body walk in the frame of the measurement?",
        "A tripod or foundation that gives way moves everything, where that frame is one for the campaign.",
        Rule(warns="beyond 3 sigma and beyond chance"),
        "See poses in the frame of the base (`[bodies] reference`); fix the instrument's stand before going on. "
        "Not evaluated: no body is the reference, fewer than eight poses show all its targets, or the frame may change "
        "from pose to pose (`[measurement] frame`).",
    ),
    "overruled": QualityCheck(
        "What does each [[exclude]], [[keep]] and [[accept]] name, and how many points or verdicts is that?",
        "A rule with a mistyped name does nothing, in silence.",
        Rule(warns="one that names nothing that was seen, or no verdict"),
        "Correct the name in the entry that is told, or take the entry out.",
    ),
    "repeatability": QualityCheck(
        "How far apart are poses and single reflectors that were taken twice, over their stated uncertainty?",
        "It is the only direct witness that the uncertainties are true of the machine and not of the fit alone.",
        Rule(
            "beyond 1.5 times, beyond chance, all together or at one pose; poses that scatter differently (p < 0.001)",
            "beyond 3 times, beyond chance, all together or at one pose",
        ),
        "Look for backlash, temperature and settling between the repeats, at the pose that is named. Not evaluated: "
        "repeat three poses.",
    ),
    "time-gaps": QualityCheck(
        "How long is the longest pause, over the usual pace?",
        "Something may have changed meanwhile: temperature, a target, the instrument's place.",
        Limits("longest pause over the usual", warn=10.0, unit="times"),
        "Write down what happened; repeat a pose from before the pause. Not evaluated: times are not recorded, or "
        "merely count the poses.",
    ),
    "time-unit": QualityCheck(
        "Can the column `time_s` be seconds, by its pace from pose to pose and by how far it counts?",
        "Days of a spreadsheet, hours or milliseconds turn every drift, creep and pause into one of another size.",
        Rule(warns="a median pace below 0.2 s or above 20000 s that another unit makes likely; counts since 1970"),
        'Say the unit in [files] (`units = { time_s = "d" }`, or `columns = { time_s = { scale = 1e-9 } }`). '
        "Passes without a word: minutes at a pace that seconds may have, and even paces of a clock. Not evaluated: "
        "fewer than 12 times, or times that merely count.",
    ),
    "temperature-span": QualityCheck(
        "How far did the temperature walk?",
        "Lengths follow it: 1 m of steel by 12 µm each kelvin.",
        Limits("span of the temperature", warn=2.0, unit="K"),
        "Keep the temperature, or record it with every pose, so that the diagnosis can ask what follows it.",
    ),
    "temperature-unit": QualityCheck(
        "Are recorded temperatures and [mechanism] reference_temperature_c in degrees Celsius?",
        "Kelvin or degrees Fahrenheit pass as a warming by tens or hundreds of kelvins, and everything grows by it.",
        Rule(
            warns="a reference like one in another unit, with nothing to contradict it",
            fails="a column and the reference that contradict each other by a unit, or parts of a column that do",
        ),
        'Say the unit in [files] (`units = { temperature_c = "K" }`), convert the rows that are named, or correct '
        "the reference. A part in another unit is told by steps of 25 K and more that the conversion undoes.",
        withholds="models",
    ),
}
