"""Checks of object points and photographs, by their names in qa.parquet."""

from __future__ import annotations

from truing.schemas.quality_check import TEMPERATURE_UNIT, CheckLimits, Checks, QualityCheck, VerdictRule, time_unit

OF_POINTS: Checks = {
    "unobserved-poses": QualityCheck(
        "Which configurations have no measured point?",
        "The pose was not measured, or its points have another pose name.",
        CheckLimits("share of the configurations without a point", warn=0.0, fail=0.3, most=1.0),
        "Compare the pose names of both tables; correct the mapping, measure the pose or delete its row.",
    ),
    "attachment-labels": QualityCheck(
        "Is each target with a `leg` nearest to the nominal attachment of that leg?",
        "A wrong leg number assigns one leg's shift to another leg.",
        VerdictRule(fails="any target nearer to another leg"),
        "Correct `leg` in targets.csv, or the order of the legs in [mechanism].",
        withholds="models",
    ),
    "completeness": QualityCheck(
        "What share of a body's target readings is missing?",
        "Targets are rarely hidden at random: whole directions or poses lose weight.",
        CheckLimits("share of the target readings missing", warn=0.1, fail=0.3, most=1.0),
        "Find the missing targets and poses; add camera stations, clean targets or repeat poses.",
    ),
    "poses-determined": QualityCheck(
        "In how many poses does a body have too few usable targets?",
        "All later results lack such a pose.",
        CheckLimits("share of the poses that cannot be determined", warn=0.05, fail=0.3, most=1.0),
        "Repeat the named poses; place targets where they stay visible.",
    ),
    "geometry": QualityCheck(
        "Does each body have three targets for its frame?",
        "Fewer targets give no orientation.",
        VerdictRule(fails="fewer than three"),
        "Add targets and survey the body again.",
    ),
    "geometry-line": QualityCheck(
        "How far do a body's targets spread across their longest axis?",
        "Targets on one line do not determine the rotation about it.",
        # Below it the roll is known to some 5 degrees at best.
        CheckLimits("spread (rms) over the noise of a target", fail=5.0, below=True, unit="sigma"),
        "Place a target well off the line and survey the body again.",
    ),
    "geometry-plane": QualityCheck(
        "How thick is a body of more than three targets, relative to its length?",
        "Mirrored labels fit coplanar targets as well as correct labels.",
        CheckLimits("thickness over length", warn=0.01, below=True),
        "Place one target out of the plane, or compare the labels with a photograph.",
    ),
    "geometry-leverage": QualityCheck(
        "What share of one target's error enters the frame?",
        "If the frame depends on one target, its residual hides its error.",
        CheckLimits("share of the target's error that enters the frame", warn=0.9, most=1.0),
        "Place a second target near the named one.",
    ),
    "gross-errors": QualityCheck(
        "How many readings are gross errors after a robust fit?",
        "A few are normal and left out. Many indicate wrong labels, a wrong survey or bad targets.",
        CheckLimits("share of gross errors", warn=0.05, fail=0.15, most=1.0),
        "Inspect the targets named most often: loose, damaged, reflecting or mislabelled?",
        not_evaluated="fewer than three targets, or one pose without a survey",
    ),
    "exchanged-labels": QualityCheck(
        "Do two targets lie at each other's positions?",
        "All results that use them are wrong.",
        VerdictRule(fails="any pair"),
        "Exchange the labels in the named poses, in the instrument's project or in the export.",
        not_evaluated="fewer than three targets, or one pose without a survey",
    ),
    "moved-targets": QualityCheck(
        "Does a target lie elsewhere from some pose on?",
        "A target that was touched looks like a deformation. The diagnosis can model it, so this only warns.",
        VerdictRule(warns="any significant step"),
        "Find out what happened before the named pose; survey the target again, or exclude it by name.",
        not_evaluated="no target is seen in six poses",
    ),
    "resurvey": QualityCheck(
        "How far are targets from their earlier survey, where no entry of campaign.toml explains it?",
        "An unnoticed move rotates the body in all later poses. The common motion of the other targets is removed. "
        "Excluded targets pass, as do targets with a `from_pose`.",
        CheckLimits("significant shift of a target over its sigma", warn=0.0, fail=10.0, unit="sigma"),
        "Give the first pose of the new position (`[[resurvey]] from_pose`; see `moved-targets`), or exclude the "
        "target by name.",
    ),
    "names-known": QualityCheck(
        "Does an unknown name lie at the position of a missing target?",
        "Instruments renumber targets and labels are replaced. The body loses such points; nothing is renamed "
        "automatically.",
        VerdictRule(warns="any"),
        "Check the `[[renamed]]` that the report proposes, then add it.",
        not_evaluated="no survey",
    ),
    "joints-against-links": QualityCheck(
        "Do joint readings agree with the measured links of a chain?",
        "A wrong unit or sign, exchanged columns or another robot bias every parameter. Such slips are tried.",
        VerdictRule(
            "two exchanged columns explain it",
            "the nominal chain misses the measured places or distances by more than 2 % of their spread",
        ),
        "If the message names a slip, correct it once you have confirmed it; else check the robot description, the "
        "names of the links and of the poses.",
        not_evaluated="no chain",
        withholds="models",
    ),
    "masses-against-lengths": QualityCheck(
        "Can an arm as long as this one have the declared masses, centres of mass and payload?",
        "Masses in g or centres in m give each deflection under weight a wrong size, or another cause.",
        VerdictRule(
            warns="a payload heavier than all links together, or a centre of mass behind its joint",
            fails="masses above those of a steel cube as long as the arm, a payload above a sixteenth of that, or "
            "centres of mass beyond three times its length or all within a thousandth of it",
        ),
        "Give mass_kg and payload_kg in kg, com_mm and payload_com_mm in mm; a URDF has kg and m.",
        not_evaluated="no masses",
        withholds="models",
    ),
    "points-against-survey": QualityCheck(
        "Does a rigid motion bring the survey onto a body's points, without mirror image or change of unit?",
        "A mirrored body or another unit makes every later result wrong.",
        VerdictRule(warns="above 10 sigma of a point, unexplained", fails="a mirror image or another unit explains it"),
        "Correct the named axis, unit or names in the export or in its mapping.",
        withholds="poses",
    ),
    "points-among-poses": QualityCheck(
        "Does one shape fit the points of a body without survey in all poses?",
        "A pose or a target in another unit, with exchanged axes or names, or from another row, spoils the shape, and "
        "every result that follows from it.",
        VerdictRule(
            warns="above 10 sigma of a point, unexplained",
            fails="a recording error in some rows explains it",
        ),
        "Correct the named poses or targets in the export.",
        not_evaluated="fewer than three poses with three targets",
        withholds="poses",
    ),
    "drives-against-poses": QualityCheck(
        "Does a body rotate by the angles that the column of the drive reads?",
        "With readings of other poses, in another unit or frozen, a deformation is attributed to wrong angles.",
        VerdictRule(fails="a body follows the drive in most poses, and not in the others"),
        "Correct the named readings, or exclude the named poses.",
        not_evaluated="several drives, or no body rotates with the drive",
        withholds="models",
    ),
    "copied-poses": QualityCheck(
        "Is each pose, and each target of a body, a separate measurement?",
        "Points equal in every digit are a copy, or the instrument stood still.",
        VerdictRule(fails="two poses, or two targets of a body in all poses, equal in every digit"),
        "Export the named poses or targets again; delete those that were not measured.",
        not_evaluated="a single pose, or a file of too coarse resolution",
        withholds="models",
    ),
    "legs-regular": QualityCheck(
        "Do the legs of [mechanism] constrain all six motions of the platform?",
        "Parallel or otherwise singular legs leave a motion free; the readings then do not determine the pose.",
        VerdictRule(fails="a motion that changes no leg"),
        "Compare a_mm, b_mm and u of [mechanism] with the drawing.",
        withholds="models",
    ),
    "readings-against-poses": QualityCheck(
        "Do actuator readings agree with the measured poses and [mechanism]?",
        "A wrong unit or sign, exchanged columns or shifted rows bias every parameter. Such slips are tried; one "
        "counts if it explains the data better than all physical effects.",
        VerdictRule(
            "misfit above 0.2 of the movement",
            "a slip explains the data, or the misfit of all legs or of one is above 0.5 of the movement",
        ),
        "Correct the slip in the message once you have confirmed it; else compare readings and poses one by one.",
        withholds="models",
    ),
    "coordinates-vary": QualityCheck(
        "Do all three coordinates of the points differ between points?",
        "A coordinate that is the same in every row was not measured: a camera over a table, a list of holes in a "
        "plate. It counts as a measurement without error, which makes rms errors and noise ratios too small.",
        VerdictRule(warns="a coordinate is the same in all points"),
        "Read errors as the message says. Nothing that happens along this coordinate can be found.",
    ),
    "noise-size": QualityCheck(
        "Do most points of a body agree within the declared noise?",
        "If most points do not, but all scatter alike, the declared noise is too small, often because of another unit. "
        "Then every point would be a gross error, and every small deviation an effect.",
        VerdictRule(
            fails="most points of a body are gross errors by the declared noise, but few by ten times that noise"
        ),
        "Declare the instrument's real noise in the unit of its key (`[noise]`, sigma columns).",
        withholds="poses",
    ),
    "noise": QualityCheck(
        "How large is the scatter of a body, and of each axis, over the declared noise?",
        "Every uncertainty and test uses the declared noise. A deviation of 10 % is normal: the test asks "
        "whether the scatter exceeds the limit significantly.",
        VerdictRule(
            "significantly above 1.1 times or below 1/1.1",
            "significantly above 1.5 times; one axis above 2.5 times; below 1/100: another unit",
        ),
        "Declare the instrument's real noise (`[noise]`, sigma columns), or find the vibration: tripod, traffic, "
        "exposure.",
    ),
    "noise-by-pose": QualityCheck(
        "Which poses are noisier than the body's usual scatter?",
        "In one noisy pose, something moved during the measurement. Many make the campaign unusable.",
        VerdictRule(
            "any pose above 1.5 times, with a chance below one in a million",
            "a tenth of the poses significantly above 3 times",
        ),
        "Repeat the named pose; let the machine settle before each pose.",
    ),
    "base-drift": QualityCheck(
        "Does the reference body drift in the measurement frame?",
        "A moving tripod or foundation moves everything, if all poses share that frame.",
        VerdictRule(warns="above 3 sigma and significant"),
        "Express poses in the frame of the base (`[bodies] reference`); fix the instrument's stand.",
        not_evaluated="no reference body, fewer than eight poses with all its targets, or a frame that may change "
        "(`[measurement] frame`)",
    ),
    "overruled": QualityCheck(
        "How many points or verdicts does each [[exclude]], [[keep]] and [[accept]] match?",
        "An entry with a mistyped name does nothing.",
        VerdictRule(warns="an entry that matches none"),
        "Correct the name in the entry, or delete the entry.",
    ),
    "repeatability": QualityCheck(
        "How large is the scatter of repeated poses and single reflectors, over their stated uncertainty?",
        "Only repeats show that the uncertainties describe the machine and not just the fit.",
        VerdictRule(
            "significantly above 1.5 times, together or at one pose; poses that scatter differently (p < 0.001)",
            "significantly above 3 times, together or at one pose",
        ),
        "Look for backlash, temperature and settling at the named pose.",
        not_evaluated="repeat three poses",
    ),
    "time-gaps": QualityCheck(
        "How long is the longest pause, relative to the usual interval?",
        "Temperature, targets or the instrument may have changed meanwhile.",
        CheckLimits("longest pause over the usual interval", warn=10.0, unit="times"),
        "Note what happened; repeat a pose from before the pause.",
        not_evaluated="times are missing, or only count poses",
    ),
    "time-unit": time_unit("pose"),
    "temperature-span": QualityCheck(
        "How much did the temperature change?",
        "1 m of steel grows by 12 µm per kelvin.",
        CheckLimits("range of the temperature", warn=2.0, unit="K"),
        "Stabilise the temperature, or record it at each pose, so that the diagnosis can test it.",
    ),
    "temperature-unit": TEMPERATURE_UNIT,
}

OF_PHOTOGRAPHS: Checks = {
    "images-oriented": QualityCheck(
        "What share of the photographs of a pose has no orientation?",
        "Such a photograph shares too few points with others, and all its rays are lost.",
        CheckLimits("share of a pose's photographs without orientation", warn=0.0, fail=0.5, most=1.0),
        "Place coded targets so that neighbouring photographs share four of them; repeat the photograph.",
    ),
    "scale": QualityCheck(
        "Does each pose have a scale, and do bars, known points and the survey agree about it?",
        "Rays alone give no scale. If lengths contradict each other, checks that depend on the scale are not "
        "evaluated.",
        VerdictRule(fails="any pose without scale; a length that differs from the others by five sigma and 0.5 mm/m"),
        "Place a scale bar in every pose and give its length in scale_bars.csv. To check the scale, use a second "
        "bar, a bar that `serves` as check, or the stated size of targets.",
        withholds="poses",
    ),
    "known-points": QualityCheck(
        "Do known points agree with the rays and with the other known points?",
        "A known point that contradicts them is left out of the datum, because it would reject its own rays. If as "
        "many contradict as agree, all get a larger sigma.",
        VerdictRule(fails="any point of a pose significantly off (p < 0.001 for all together), or left without rays"),
        "Verify coordinates and names of the named points in known_points.csv and in the photographs.",
    ),
    "target-sizes": QualityCheck(
        "How large are measured circles and markers, relative to their stated size?",
        "If a survey or a single bar gives the scale, only this check detects a length in another unit. Markers that "
        "give the scale do not count.",
        CheckLimits("measured over stated size, or stated over measured", warn=1.25, fail=3.0, unit="times"),
        "Check the units of the survey and of scale_bars.csv, and the stated sizes (`target_mm`, `marker_mm`, "
        "`image_targets.csv`): diameter of the dot, edge of the dark square.",
        withholds="poses",
    ),
    "rays-per-point": QualityCheck(
        "What share of a pose's object points has fewer than three rays?",
        "If two rays do not meet, nothing shows which one is wrong.",
        CheckLimits("share of the points with fewer than three rays", warn=0.1, fail=0.5, most=1.0),
        "Photograph the named points from more directions.",
    ),
    "intersection-angles": QualityCheck(
        "At what largest angle do the rays of the worst tenth of a pose's points meet?",
        "Small angles leave the distance from the cameras uncertain.",
        CheckLimits(
            "largest angle of the rays to a point, of the worst tenth", warn=30.0, fail=5.0, below=True, unit="deg"
        ),
        "Move the stations further apart, up to a right angle, and photograph from above and below.",
    ),
    "format-coverage": QualityCheck(
        "What share of a camera's format do all its image points together cover?",
        "Distortion is estimated where image points lie, and extrapolated elsewhere.",
        CheckLimits("share of the format's cells (5 x 5) with image points", warn=0.6, fail=0.1, below=True, most=1.0),
        "Move nearer, and place the object in the corners of some photographs.",
    ),
    "image-noise": QualityCheck(
        "How large is the noise of each camera and kind of target, relative to the stated noise?",
        "The residuals give this noise (variance components) and it scales the sigmas of points. A ratio far from 1 "
        "indicates blur, a moving object or unmodelled distortion.",
        CheckLimits("measured over stated noise, or stated over measured", warn=2.0, fail=10.0, unit="times"),
        "Look at the residuals of the photographs; state the camera's real noise (`[noise] image_px`).",
    ),
    "rejected-rays": QualityCheck(
        "What share of a camera's rays was rejected?",
        "A few are normal. Many indicate misread codes, merged targets, reflections or a moving object.",
        CheckLimits("share of the rays rejected", warn=0.05, fail=0.3, most=1.0),
        "Start with the photographs that the report lists first; cover reflections, enlarge the targets.",
    ),
    "residuals-systematic": QualityCheck(
        "Do residuals have a mean other than zero in some part of a camera's format?",
        "The camera model lacks a distortion, or the camera changed.",
        VerdictRule(warns="any part significant (p < 0.001) and above a tenth of the noise"),
        "Free more camera parameters (`[[cameras]] free`); fix its focus; divide the photographs among two cameras.",
    ),
    "camera-stability": QualityCheck(
        "Do photographs by one camera differ in principal distance, or poses in principal distance and point?",
        "Photographs share one camera model. If the camera changes, points shift and look like a deformation. Each "
        "photograph is compared with the majority.",
        VerdictRule(
            warns="significant (p < 0.001)",
            fails="significant, and a separate camera for these photographs moves points by more than their sigma; "
            "poses that differ by more than three times their uncertainty",
        ),
        "Give the named photographs their own camera (`of`, `poses`, `images` of `[[cameras]]`). Fix focus, zoom and "
        "stabiliser; let the camera warm up.",
    ),
    "bar-lengths": QualityCheck(
        "How far is each adjusted scale bar from its calibrated length, over the uncertainty of the difference?",
        "A bar that contradicts the others is bent, warm, misnumbered or wrongly calibrated.",
        CheckLimits("largest deviation of the bar over its sigma", warn=4.0, fail=20.0, unit="sigma"),
        "Compare its ends with a photograph, its length with the certificate; check its temperature.",
    ),
    "length-errors": QualityCheck(
        "How large is the error of the lengths that check the scale, relative to their length?",
        "VDI/VDE 2634 part 1 accepts photogrammetric systems by this figure; set your own limit. Lengths that give the "
        "scale do not count.",
        CheckLimits("largest error of a length that checks, over the length", warn=100.0, unit="um/m"),
        "Find what distorts the network: too few directions, a changed camera, a scale bar in one corner.",
    ),
}
