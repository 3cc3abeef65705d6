"""Columns of quality checks and of rows left out."""

from __future__ import annotations

from truing.schemas.column import integer, real, text

QUALITY_COLUMNS = (
    text("check", "name of the check"),
    real("limit", "", "limit for the verdict, in the unit of its row", nullable=True),
    text("accepted", "person who accepted the verdict, and reason; empty if nobody did", nullable=True),
    text(
        "relation",
        "tested relation between two parts of the campaign: the name of its check. For a cause, the relation that "
        "its search uses: readings-poses, loads-readings, loads-signals, commands-encoders, targets-positions, "
        "joints-links, bodies-survey or rays-points",
        nullable=True,
    ),
    text("section", "section of the report, or campaign"),
    text("decided_by", "for campaign: the section whose state it takes; empty for a section", nullable=True),
    text(
        "test",
        "tested property of the model's residuals: larger noise of observations or inputs than declared; correlation "
        "between neighbours along a column (like-neighbours), or between neighbouring targets within an epoch "
        "(like-places); a mean over repeated epochs beyond their scatter "
        "(pure-error: the F test of lack of fit), or within a region of the inputs (by-region); a further "
        "significant cause (causes-left); errors of single parts that depend on inputs (parts: listed only where the "
        "search for them ended early)",
        choices=(
            "observation-noise",
            "input-noise",
            "like-neighbours",
            "like-places",
            "pure-error",
            "by-region",
            "causes-left",
            "parts",
        ),
    ),
    text(
        "why_untested",
        "why there is no test: no command was measured twice, too few epochs, or it would take too long",
        nullable=True,
        choices=("no-repeats", "too-few", "too-large"),
    ),
    text(
        "search_end",
        "why the search for causes stopped: no significant cause is left (complete); eight or more causes were "
        "accepted, and no other one is known to predict held-out epochs better (most-causes), or further fits would "
        "take too long (time); or three unnamed effects were accepted and more is significant (unnamed-effects), or "
        "two sudden changes of one part, and the next is one more (events); or the significant causes that are left "
        "predict held-out epochs worse (refused)",
        nullable=True,
        choices=("complete", "most-causes", "unnamed-effects", "events", "time", "refused"),
    ),
    text("left_cause", "cause that would be accepted next; empty if there is none", nullable=True),
    text("left_subject", "subject of left_cause; empty for the whole, or if there is none", nullable=True),
    text(
        "along",
        "column along which neighbours are compared; several columns are separated by blanks; empty for noise and "
        "repeats",
    ),
    text(
        "state",
        "result of the test of a relation or of a model, or of all tests of a section",
        choices=("ok", "attention", "fails", "not tested"),
    ),
    text(
        "reason_code",
        "code of the reason for the state or the verdict. Of a cause: found; noise; remainder (columns predict the "
        "misfit where no model holds); rival; chance; held-out (worse prediction); dropped (not needed next to "
        "others); contained (in a found cause); unseen (the campaign cannot show it); alternative, inadequate, "
        "unnamed, course, assumed, not-random, unpaid, weak, unconfirmed, elsewhere (suspected: docs/diagnosis.md); "
        "ended (search ended without it); no-time, no-up, ... (a quantity is not recorded). Of a section: "
        "docs/verdict.md",
    ),
    real("misfit", "", "rms misfit of the relation as recorded; a count or ratio in unit 1", nullable=True),
    real("misfit_explained", "", "rms misfit with the slips corrected; empty if no slip explains it", nullable=True),
    text("slips", "JSON list of the slips that together explain the data: kind, quantity, subjects, factor"),
    text("rivals", "JSON list of other slips that explain the data equally well"),
    text("hidden_slips", "JSON list of slips that this campaign cannot show"),
    integer("tried", "number of hypotheses tried", minimum=0),
    integer("rows", "number of rows concerned", minimum=0),
    text("by", "rule or person that left the rows out"),
)
