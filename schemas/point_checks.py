"""The checks of a campaign of object points, and of photographs that they come from, by their names in qa.parquet."""

from __future__ import annotations

from truing.schemas.quality_check import TEMPERATURE_UNIT, CheckLimits, Checks, QualityCheck, VerdictRule, time_unit

OF_POINTS: Checks = {
    "unobserved-poses": QualityCheck(
        "Of which configurations was no point measured?",
        "A pose that was not photographed is missing where it was planned to tell something; more often its points are "
        "there under another name.",
        CheckLimits("share of the configurations without a point", warn=0.0, fail=0.3, most=1.0),
        "Compare the pose names of both tables; mend the mapping, measure the pose, or take its row out.",
    ),
    "attachment-labels": QualityCheck(
        "Does each target with a `leg` lie nearest to that leg's own nominal attachment?",
        "A target given to a wrong leg gives that leg the shift of another one.",
        VerdictRule(fails="any that does not"),
        "Correct `leg` in targets.csv, or the order of the legs in [mechanism].",
        withholds="models",
    ),
    "completeness": QualityCheck(
        "Which share of a body's target readings is missing?",
        "What is hidden is rarely hidden at random: whole directions or poses lose their weight.",
        CheckLimits("share of the target readings missing", warn=0.1, fail=0.3, most=1.0),
        "Look which targets and poses are missing; add camera stations, clean the targets, or repeat those poses.",
    ),
    "poses-determined": QualityCheck(
        "In how many poses has a body too few usable targets?",
        "Such a pose is lost to everything that follows.",
        CheckLimits("share of the poses that cannot be determined", warn=0.05, fail=0.3, most=1.0),
        "Repeat the poses that are named; put targets where they stay visible.",
    ),
    "geometry": QualityCheck(
        "Has a body three targets that make its frame?",
        "With fewer, it has no orientation.",
        VerdictRule(fails="fewer than three"),
        "Put more targets on it and survey it anew.",
    ),
    "geometry-line": QualityCheck(
        "How far do a body's targets spread across their longest axis?",
        "Targets in a line leave the roll about it free.",
        # Below it the roll is known to some 5 degrees at best.
        CheckLimits("spread (rms) over the noise of a target", fail=5.0, below=True, unit="sigma"),
        "Put a target well off the line and survey the body anew.",
    ),
    "geometry-plane": QualityCheck(
        "How thick is a body of more than three targets, over its length?",
        "In a plane, labels that are mirrored fit as well as right ones, and go unnoticed.",
        CheckLimits("thickness over length", warn=0.01, below=True),
        "Put one target out of the plane; else compare the labels with a photograph.",
    ),
    "geometry-leverage": QualityCheck(
        "Which share of a target's own error stays in the frame?",
        "A frame that hangs on one target moves with it, and its residual shows nothing.",
        CheckLimits("share of the target's error that stays in the frame", warn=0.9, most=1.0),
        "Put a second target near to the one that is named.",
    ),
    "gross-errors": QualityCheck(
        "How many readings are far from their place, after a robust fit?",
        "A few are ordinary and left out; many say that labels, the survey or the targets themselves are wrong.",
        CheckLimits("share of the readings far from their place", warn=0.05, fail=0.15, most=1.0),
        "Look at the targets that are named most often: loose, damaged, reflecting, or labelled wrongly? Not "
        "evaluated: fewer than three targets, or one pose without a survey.",
    ),
    "exchanged-labels": QualityCheck(
        "Do two targets lie on each other's places?",
        "Every figure that rests on them is wrong, and the mend is in the laboratory's hands.",
        VerdictRule(fails="any pair"),
        "Exchange the labels in the poses that are named, in the instrument's project or in the export. Not evaluated: "
        "fewer than three targets, or one pose without a survey.",
    ),
    "moved-targets": QualityCheck(
        "Does a target sit elsewhere from some pose on?",
        "A sticker that was touched looks like a deformation. It can be modelled, and so does not gate.",
        VerdictRule(warns="any, beyond chance at its share"),
        "Find out what happened before the pose that is named; survey the target anew, or exclude it by name. "
        "Not evaluated: no target is seen in six poses.",
    ),
    "resurvey": QualityCheck(
        "How far do targets lie from where they were surveyed before, where nothing takes that into account?",
        "A target that moved and was not noticed turns the body in all poses after. Those that lie elsewhere beyond "
        "chance are named, the common motion of the others taken out; one that holds anew from a pose on, or is "
        "excluded, passes.",
        CheckLimits("shift of a target that moved beyond chance, over its sigma", warn=0.0, fail=10.0, unit="sigma"),
        "Say from which pose on the new place holds (`[[resurvey]] from_pose`; `moved-targets` tells when), or exclude "
        "the target by name.",
    ),
    "names-known": QualityCheck(
        "Does a name that the survey does not know lie at the place of a target that is missing there?",
        "Instruments number anew, and labels are replaced: such points are lost to the body as long as nobody says "
        "which target they are. Nothing is renamed by itself.",
        VerdictRule(warns="any"),
        "Write the `[[renamed]]` that the report proposes, once you have looked. Not evaluated: no survey.",
    ),
    "points-against-survey": QualityCheck(
        "Are a body's points its survey, moved: not its mirror image, and in the same unit?",
        "A mirrored body or another unit fits nothing, and every later figure rests on it.",
        VerdictRule(
            warns="beyond 10 sigma of a point, unexplained", fails="a mirror image or another unit explains it"
        ),
        "Correct the axis, the unit or the names that the message names, in the export or in its mapping.",
        withholds="poses",
    ),
    "copied-poses": QualityCheck(
        "Is each pose a measurement of its own?",
        "Points that agree in every digit are a copy, or come from an instrument that stood still. Not evaluated where "
        "a single pose was measured, or the file's resolution is too coarse to tell.",
        VerdictRule(fails="two poses the same in every digit"),
        "Export the poses that are named again; take out those that were not measured.",
        withholds="models",
    ),
    "legs-regular": QualityCheck(
        "Do the legs of [mechanism] hold the platform in all six directions?",
        "Parallel or otherwise singular legs leave a motion free: no readings say where the platform is.",
        VerdictRule(fails="a motion that changes no leg"),
        "Compare a_mm, b_mm and u of [mechanism] with the drawing.",
        withholds="models",
    ),
    "readings-against-poses": QualityCheck(
        "Do actuator readings move as the measured poses and [mechanism] ask for?",
        "A unit, a sign, an exchanged column or a shifted row bends every parameter, and a matrix can swallow it. "
        "Plausible slips in readings, rows and description are tried; one counts if it beats all physical effects.",
        VerdictRule(
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
        VerdictRule(
            "beyond 1.1 times either way, beyond chance",
            "beyond 1.5 times, beyond chance; one axis beyond 2.5 times",
        ),
        "Declare what the instrument does (`[noise]`, sigma columns), or find what shakes: tripod, traffic, exposure.",
    ),
    "noise-by-pose": QualityCheck(
        "Which poses are noisier than the body's ordinary scatter?",
        "One is a pose to look at: something moved while it was taken. Many are no campaign.",
        VerdictRule(
            "any beyond 1.5 times, at one in a million", "beyond 3 times in a tenth of the poses, beyond chance"
        ),
        "Repeat the pose that is named; let the machine settle before each pose.",
    ),
    "base-drift": QualityCheck(
        "Does the reference body walk in the frame of the measurement?",
        "A tripod or foundation that gives way moves everything, where that frame is one for the campaign.",
        VerdictRule(warns="beyond 3 sigma and beyond chance"),
        "See poses in the frame of the base (`[bodies] reference`); fix the instrument's stand before going on. "
        "Not evaluated: no body is the reference, fewer than eight poses show all its targets, or the frame may change "
        "from pose to pose (`[measurement] frame`).",
    ),
    "overruled": QualityCheck(
        "What does each [[exclude]], [[keep]] and [[accept]] name, and how many points or verdicts is that?",
        "A rule with a mistyped name does nothing, in silence.",
        VerdictRule(warns="one that names nothing that was seen, or no verdict"),
        "Correct the name in the entry that is told, or take the entry out.",
    ),
    "repeatability": QualityCheck(
        "How far apart are poses and single reflectors that were taken twice, over their stated uncertainty?",
        "It is the only direct witness that the uncertainties are true of the machine and not of the fit alone.",
        VerdictRule(
            "beyond 1.5 times, beyond chance, all together or at one pose; poses that scatter differently (p < 0.001)",
            "beyond 3 times, beyond chance, all together or at one pose",
        ),
        "Look for backlash, temperature and settling between the repeats, at the pose that is named. Not evaluated: "
        "repeat three poses.",
    ),
    "time-gaps": QualityCheck(
        "How long is the longest pause, over the usual pace?",
        "Something may have changed meanwhile: temperature, a target, the instrument's place.",
        CheckLimits("longest pause over the usual", warn=10.0, unit="times"),
        "Write down what happened; repeat a pose from before the pause. Not evaluated: times are not recorded, or "
        "merely count the poses.",
    ),
    "time-unit": time_unit("pose"),
    "temperature-span": QualityCheck(
        "How far did the temperature walk?",
        "Lengths follow it: 1 m of steel by 12 µm each kelvin.",
        CheckLimits("span of the temperature", warn=2.0, unit="K"),
        "Keep the temperature, or record it with every pose, so that the diagnosis can ask what follows it.",
    ),
    "temperature-unit": TEMPERATURE_UNIT,
}

OF_PHOTOGRAPHS: Checks = {
    "images-oriented": QualityCheck(
        "Which share of the photographs of a pose has no orientation?",
        "Such a photograph sees too few points that others see, and all its rays are lost.",
        CheckLimits("share of a pose's photographs without orientation", warn=0.0, fail=0.5, most=1.0),
        "Put coded targets where neighbouring photographs both see four of them; take the photograph anew.",
    ),
    "scale": QualityCheck(
        "Does anything give each pose its scale, and do bars, known points and the survey agree about it?",
        "Rays alone leave all lengths open together. Where lengths contradict each other, checks that this trips are "
        "not evaluated.",
        VerdictRule(fails="any pose without; a length that contradicts the others beyond five sigma and 0.5 mm/m"),
        "Lay a scale bar into every pose, and say in scale_bars.csv how long it is. Where nothing checks the scale: a "
        "second bar would, one that `serves` as check, or the stated size of targets.",
        withholds="poses",
    ),
    "known-points": QualityCheck(
        "Do known points lie where rays and the other known points have them?",
        "A known point that contradicts them is left out of the datum: it would reject its own rays and bend the rest. "
        "Where as many contradict as agree, all count as known less well.",
        VerdictRule(
            fails="any point of a pose beyond chance (p < 0.001 of all together), or without a ray that is left"
        ),
        "Look up coordinates and names of the points that are named, in known_points.csv and in the photographs.",
    ),
    "target-sizes": QualityCheck(
        "How large are circles and markers on the scale that was found, over what is stated of them?",
        "Where the scale comes from a survey or a single bar, this alone tells a length in another unit. Sizes are "
        "those of `target_mm`, `marker_mm` and `image_targets.csv`; markers that give the scale do not count.",
        CheckLimits("measured over stated size, or stated over measured", warn=1.25, fail=3.0, unit="times"),
        "Look at the units of the survey and of scale_bars.csv, and at what is stated of targets: the diameter of the "
        "dot, the edge of the dark square.",
        withholds="poses",
    ),
    "rays-per-point": QualityCheck(
        "Which share of a pose's object points is seen in fewer than three photographs?",
        "Two rays meet or do not: which of them is wrong, nobody can tell.",
        CheckLimits("share of the points with fewer than three rays", warn=0.1, fail=0.5, most=1.0),
        "Take photographs of the points that are named from further sides.",
    ),
    "intersection-angles": QualityCheck(
        "At what angle do the rays to the worst-placed tenth of a pose's points meet, at most?",
        "Rays that meet at a sharp angle leave the distance from the cameras open.",
        CheckLimits(
            "largest angle of the rays to a point, of the worst tenth", warn=30.0, fail=5.0, below=True, unit="deg"
        ),
        "Stand further apart, at right angles if there is room, and photograph from above and below.",
    ),
    "format-coverage": QualityCheck(
        "Which share of a camera's format do its image points cover, of all photographs together?",
        "Distortion is estimated where there are points; beyond them it is only continued.",
        CheckLimits("share of the format's cells (5 x 5) with image points", warn=0.6, fail=0.1, below=True, most=1.0),
        "Fill the picture: go nearer, and let the object lie in the corners of some photographs.",
    ),
    "image-noise": QualityCheck(
        "How large is the noise of each camera and kind of target, over what is stated of the rays?",
        "It is what the residuals of the adjustment say (variance components); sigmas of points are made with it. Far "
        "from one, something is in the rays that nobody stated: blur, a moving object, distortion of another kind.",
        CheckLimits("noise over stated, or stated over noise", warn=2.0, fail=10.0, unit="times"),
        "Look at the residuals of the photographs; state the noise that the camera has (`[noise] image_px`).",
    ),
    "rejected-rays": QualityCheck(
        "Which share of a camera's rays was rejected?",
        "A few are ordinary. Many are misread codes, merged targets, reflections, or an object that moved.",
        CheckLimits("share of the rays rejected", warn=0.05, fail=0.3, most=1.0),
        "Look at the photographs that the report names first; cover what reflects, enlarge the targets.",
    ),
    "residuals-systematic": QualityCheck(
        "Do residuals have a mean of their own in some part of a camera's format?",
        "Noise has none: it is distortion that the camera's model does not have, or a camera that changed.",
        VerdictRule(warns="any part beyond chance (p < 0.001) and beyond a tenth of the noise"),
        "Free more parameters of the camera (`[[cameras]] free`); fix its focus; group photographs into two cameras.",
    ),
    "camera-stability": QualityCheck(
        "Do photographs by one camera differ in principal distance, or its poses in principal distance and point?",
        "All photographs share one camera: where it changes, points are bent, and the deformation found is the lens's. "
        "Each photograph is held against what most share, so that a few that changed are named, and no other.",
        VerdictRule(
            warns="beyond chance (p < 0.001)",
            fails="beyond chance, and points move by more than their sigma where these photographs have a camera of "
            "their own; poses that differ by more than three times their uncertainty",
        ),
        "Give the photographs that are named a camera of their own (`of`, `poses`, `images` of `[[cameras]]`). Fix "
        "focus, zoom and stabiliser, let the camera warm up. The diagnosis asks what the change follows.",
    ),
    "bar-lengths": QualityCheck(
        "How far is each scale bar's length as adjusted from the calibrated one, over the uncertainty of that?",
        "A bar that contradicts the others is bent, warm, misnumbered, or was calibrated otherwise.",
        CheckLimits("largest deviation of the bar over its sigma", warn=4.0, fail=20.0, unit="sigma"),
        "Compare its ends with a photograph and its length with the certificate; think of its temperature.",
    ),
    "length-errors": QualityCheck(
        "How large is the length error of the reference lengths that check the scale, over their length?",
        "It is the figure by which photogrammetric systems are accepted (VDI/VDE 2634 part 1); set the limit that "
        "yours has to keep. Lengths that gave the scale do not count.",
        CheckLimits("largest error of a length that checks, over the length", warn=100.0, unit="um/m"),
        "Look for what bends the network: too few sides, a camera that changed, a scale bar in one corner.",
    ),
}
