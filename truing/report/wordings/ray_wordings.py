"""What cameras, scale bars and the air before the lens do."""

from __future__ import annotations

from truing.report.wordings.claim import Claim, Wording
from truing.report.wordings.parts import with_sizes

_STIR = "Measure the temperature of the air at three heights; stir it with a fan and repeat some poses."
_FORMS = {
    "temperature": ("follows the temperature", "follow the temperature"),
    "scatter": ("differs from pose to pose, without order", "differ from pose to pose, without order"),
    "drift": ("drifts evenly with time", "drift evenly with time"),
    "settles": ("drifts with time, ever more slowly", "drift with time, ever more slowly"),
}


def _unstable(claim: Claim) -> str:
    what = set(claim.fact("what") or ("c",))
    parts = ["principal distance"] * ("c" in what) + ["principal point"] * bool(what - {"c"})
    several = len(parts) > 1
    jumps = f"{'are others' if several else 'is another one'} from pose {claim.fact('from_pose')} on"
    one, many = _FORMS.get(str(claim.fact("form")), (jumps, jumps))
    return with_sizes(f"the {' and the '.join(parts)} of {claim.subject} {many if several else one}", claim)


def _hold_still(claim: Claim) -> str:
    return (
        f"Photograph a field of targets that holds still with {claim.subject}, rolled by 90 degrees in every second "
        "image, before and after what it went through, and adjust its interior orientation each time."
    )


def _bent(claim: Claim) -> str:
    if claim.subject:
        pane = "looks through a pane of glass, which shifts rays the more the more they lean"
        return with_sizes(f"{claim.subject} {pane}", claim)
    if claim.fact("scale_height_m") is not None:
        bent = "measured shapes are bent as by air whose refractive index changes evenly with height"
        return with_sizes(f"{bent}, which rays do not show", claim)
    return with_sizes("rays are bent: the refractive index of the air changes unevenly with height", claim)


def _without_pane(claim: Claim) -> str:
    if not claim.subject:
        return _STIR
    return f"Repeat some poses without what is before the lens of {claim.subject}, at two distances."


def _warm_bars(claim: Claim) -> str:
    if claim.fact("bar"):
        own = f"scale bar {claim.fact('bar')} grows with temperature otherwise than stated"
        return with_sizes(f"{own}, seen beside the other bars", claim)
    all_bars = "the scale bars grow with temperature otherwise than stated"
    return with_sizes(f"{all_bars}, so that all that is measured shrinks by as much", claim)


def _calibrate_bars(claim: Claim) -> str:
    if claim.fact("bar"):
        which, it = f"bar {claim.fact('bar')}", "it"
    else:
        which, it = "the bars", "one"
    return f"Calibrate {which} at two temperatures, or photograph {it} beside a bar of known expansion at both."


RAYS = {
    "camera-instability": Wording("camera instability", _unstable, _hold_still),
    "refraction": Wording("refraction", _bent, _without_pane),
    "scale-bar-temperature": Wording("scale bar temperature", _warm_bars, _calibrate_bars),
}
