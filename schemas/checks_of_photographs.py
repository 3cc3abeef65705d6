"""The checks of a campaign whose points come out of photographs, by their names in qa.parquet."""

from __future__ import annotations

from truing.schemas.quality_check import Checks, Limits, QualityCheck, Rule

OF_PHOTOGRAPHS: Checks = {
    "images-oriented": QualityCheck(
        "Which share of the photographs of a pose has no orientation?",
        "Such a photograph sees too few points that others see, and all its rays are lost.",
        Limits("share of a pose's photographs without orientation", warn=0.0, fail=0.5, most=1.0),
        "Put coded targets where neighbouring photographs both see four of them; take the photograph anew.",
    ),
    "scale": QualityCheck(
        "Does anything give each pose its scale, and do bars, known points and the survey agree about it?",
        "Rays alone leave all lengths open together. Where lengths contradict each other, checks that this trips are "
        "not evaluated.",
        Rule(fails="any pose without; a length that contradicts the others beyond five sigma and 0.5 mm/m"),
        "Lay a scale bar into every pose, and say in scale_bars.csv how long it is. Where nothing checks the scale: a "
        "second bar would, one that `serves` as check, or the stated size of targets.",
        withholds="poses",
    ),
    "known-points": QualityCheck(
        "Do known points lie where rays and the other known points have them?",
        "A known point that contradicts them is left out of the datum: it would reject its own rays and bend the rest. "
        "Where as many contradict as agree, all count as known less well.",
        Rule(fails="any point of a pose beyond chance (p < 0.001 of all together), or without a ray that is left"),
        "Look up coordinates and names of the points that are named, in known_points.csv and in the photographs.",
    ),
    "target-sizes": QualityCheck(
        "How large are circles and markers on the scale that was found, over what is stated of them?",
        "Where the scale comes from a survey or a single bar, this alone tells a length in another unit. Sizes are "
        "those of `target_mm`, `marker_mm` and `image_targets.csv`; markers that give the scale do not count.",
        Limits("measured over stated size, or stated over measured", warn=1.25, fail=3.0, unit="times"),
        "Look at the units of the survey and of scale_bars.csv, and at what is stated of targets: the diameter of the "
        "dot, the edge of the dark square.",
        withholds="poses",
    ),
    "rays-per-point": QualityCheck(
        "Which share of a pose's object points is seen in fewer than three photographs?",
        "Two rays meet or do not: which of them is wrong, nobody can tell.",
        Limits("share of the points with fewer than three rays", warn=0.1, fail=0.5, most=1.0),
        "Take photographs of the points that are named from further sides.",
    ),
    "intersection-angles": QualityCheck(
        "At what angle do the rays to the worst-placed tenth of a pose's points meet, at most?",
        "Rays that meet at a sharp angle leave the distance from the cameras open.",
        Limits("largest angle of the rays to a point, of the worst tenth", warn=30.0, fail=5.0, below=True, unit="deg"),
        "Stand further apart, at right angles if there is room, and photograph from above and below.",
    ),
    "format-coverage": QualityCheck(
        "Which share of a camera's format do its image points cover, of all photographs together?",
        "Distortion is estimated where there are points; beyond them it is only continued.",
        Limits("share of the format's cells (5 x 5) with image points", warn=0.6, fail=0.1, below=True, most=1.0),
        "Fill the picture: go nearer, and let the object lie in the corners of some photographs.",
    ),
    "image-noise": QualityCheck(
        "How large is the noise of each camera and kind of target, over what is stated of the rays?",
        "It is what the residuals of the adjustment say (variance components); sigmas of points are made with it. Far "
        "from one, something is in the rays that nobody stated: blur, a moving object, distortion of another kind.",
        Limits("noise over stated, or stated over noise", warn=2.0, fail=10.0, unit="times"),
        "Look at the residuals of the photographs; state the noise that the camera has (`[noise] image_px`).",
    ),
    "rejected-rays": QualityCheck(
        "Which share of a camera's rays was rejected?",
        "A few are ordinary. Many are misread codes, merged targets, reflections, or an object that moved.",
        Limits("share of the rays rejected", warn=0.05, fail=0.3, most=1.0),
        "Look at the photographs that the report names first; cover what reflects, enlarge the targets.",
    ),
    "residuals-systematic": QualityCheck(
        "Do residuals have a mean of their own in some part of a camera's format?",
        "Noise has none: it is distortion that the camera's model does not have, or a camera that changed.",
        Rule(warns="any part beyond chance (p < 0.001) and beyond a tenth of the noise"),
        "Free more parameters of the camera (`[[cameras]] free`); fix its focus; group photographs into two cameras.",
    ),
    "camera-stability": QualityCheck(
        "Do photographs by one camera differ in principal distance, or its poses in principal distance and point?",
        "All photographs share one camera: where it changes, points are bent, and the deformation found is the lens's. "
        "Each photograph is held against what most share, so that a few that changed are named, and no other.",
        Rule(
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
        Limits("largest deviation of the bar over its sigma", warn=4.0, fail=20.0, unit="sigma"),
        "Compare its ends with a photograph and its length with the certificate; think of its temperature.",
    ),
    "length-errors": QualityCheck(
        "How large is the length error of the reference lengths that check the scale, over their length?",
        "It is the figure by which photogrammetric systems are accepted (VDI/VDE 2634 part 1); set the limit that "
        "yours has to keep. Lengths that gave the scale do not count.",
        Limits("largest error of a length that checks, over the length", warn=100.0, unit="um/m"),
        "Look for what bends the network: too few sides, a camera that changed, a scale bar in one corner.",
    ),
}
