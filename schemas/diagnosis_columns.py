"""Columns of the diagnosis, the extended model, the next measurements and the comparison of runs."""

from __future__ import annotations

from truing.schemas.column import flag, integer, real, share, size, text
from truing.schemas.needs import Need

DIAGNOSIS_COLUMNS = (
    integer("rank", "1 is the most probable, or the worst", minimum=1),
    text("cause", "id of the cause in the catalogue, or unexplained"),
    text("asked", "key of [diagnosis] that names the cause", choices=("apply", "ignore")),
    text(
        "outcome",
        "outcome of the request; no effect: found, but no calibrated quantity depends on it",
        choices=("applied", "not found", "no effect", "ignored"),
    ),
    text(
        "verdict",
        "result: pass, warn, fail; found, suspected, indistinguishable, rejected, not testable; agrees, differs; "
        "negligible, not negligible",
        nullable=True,
    ),
    share("probability", "probability among the candidates, given the data", nullable=True),
    text("parameters", "JSON: name to value, sigma and unit"),
    text("follows", "for unexplained: the columns on which it depends, separated by blanks", nullable=True),
    *(
        size(
            f"{held}rms_{when}",
            "unit",
            f"rms of measured minus predicted, {when} this cause is accepted",
            nullable=True,
        )
        for held in ("", "heldout_")
        for when in ("before", "after")
    ),
    size(
        "noise_floor",
        "unit",
        "rms expected from the declared noise alone, after the fit of the parameters",
        nullable=True,
    ),
    text("explanation", "what, where, how large, how certain"),
    text("rival", "cause that this campaign does not separate from it", nullable=True),
    text(
        "settings",
        "JSON: fields of the cause as in model.toml, which identify the candidate, and the step of the forward pass "
        "at which it acts",
        nullable=True,
    ),
    text("clause", "physical effect without sizes, as the end of a sentence", nullable=True),
    size("largest_motion", "unit", "largest change of any measured quantity by the effect", nullable=True),
    text(
        "advice_kind",
        "purpose of the next measurement: separate it from its rival; with another kind of measurement; confirm it; "
        "reduce its uncertainty (sharpen); no number of repeats helps (in vain)",
        nullable=True,
        choices=("separate", "another kind", "confirm", "sharpen", "in vain"),
    ),
    text("next_in_short", "next_measurement without settings that a table holds; else empty", nullable=True),
    text("next_purpose", "purpose of its rows in next_poses or next_loads; empty if it has none", nullable=True),
    text("next_measurement", "measurement that confirms it, or separates it from its rivals", nullable=True),
    flag("in_model", "whether the extended model holds the effect; empty in rows on noise or residuals", nullable=True),
    size(
        "rms_without_any",
        "unit",
        "rms of measured minus predicted on fitted data without any accepted cause; empty if a cause is known before "
        "the search",
        nullable=True,
    ),
    size("heldout_rms_without_any", "unit", "the same on data that the fit did not use", nullable=True),
    size(
        "heldout_growth",
        "1",
        "rms of all held-out errors, each in units of its noise, with the cause over that without it; other units than "
        "that of the row count here, too",
        nullable=True,
    ),
    share(
        "p_deviates",
        "p-value of the residuals of the pose without the largest of them, at the noise found, corrected for the "
        "number of poses; empty for held-out poses, and with fewer than two values",
        nullable=True,
    ),
    size("rms_nominal", "unit", "rms of measured minus predicted by the nominal geometry of a chain", nullable=True),
    size("sigma_of_fit", "unit", "rms error of a prediction by the uncertainty of the fit alone", nullable=True),
    text("determined", "linear combination of the parameters of a cause, with its largest coefficients"),
    text("coefficients", "JSON: coefficient of each parameter in a combination; their squares sum to 1"),
    real("combined_value", "unit", "value of the combination, in the unit of the parameters"),
    size("combined_sigma", "unit", "standard uncertainty of the combination, in the unit of the parameters"),
    share(
        "share_explained",
        "share of a named cause in what it and unnamed effects explain together, in squares; empty without a "
        "competing unnamed effect",
        nullable=True,
    ),
    text(
        "left_out_by",
        "kind of blocks left out in turn to test the cause: the first kind of which two blocks respond to it; "
        "one-block: at most one block responds enough; none: the campaign has no three blocks of any kind",
        nullable=True,
        choices=("series", "run", "day", "direction", "region", "one-block", "none"),
    ),
    integer("left_out_blocks", "number of blocks that respond to the cause", minimum=0, nullable=True),
    real(
        "left_out_gain",
        "",
        "log of the probability ratio of these blocks, with and without the cause, each predicted from the others",
        nullable=True,
    ),
    share(
        "share_predicted",
        "for unexplained effects outside the extended model: share of the plain simulation's misfit that the columns "
        "predict, in squares, minus the share expected by chance",
        nullable=True,
    ),
    size(
        "signal_to_noise",
        "",
        "size of the effect over its noise, without the part that nuisance parameters absorb",
        nullable=True,
    ),
    real("log_evidence", "", "log of the odds against the model without it", nullable=True),
    text(
        "scale_holds",
        "whether its rank holds if plausible scales are tripled",
        nullable=True,
        choices=("holds", "changes"),
    ),
    # Extended model and next measurements.
    size("size", "", "smallest size that is found with probability power", nullable=True),
    share("power", "probability of finding an effect of that size"),
    *(
        real(f"pull_{when}", "", f"shift from nominal over its expected standard deviation, {model}", nullable=True)
        for when, model in (("before", "no effect in the model"), ("after", "found effects in the model"))
    ),
    real("offset_after", "unit", "error of the nominal value if it alone is wrong; empty for a sensor", nullable=True),
    size("explained_after", "", "part of the sum of squared pulls that this error would explain", nullable=True),
    size("chi_square", "", "sum of squared pulls, with their correlations", nullable=True),
    integer("freedom", "number of independent pulls", minimum=0),
    *(
        size(
            f"largest_{when}",
            "unit",
            f"largest of measured minus predicted {when} the extension; empty where all values of a pose are left out",
            nullable=True,
        )
        for when in ("before", "after")
    ),
    text("purpose", "purpose of the measurement: the cause to confirm, or the two to separate"),
    text(
        "need",
        "need for the measurement, the most urgent first: an undecided requirement; rivals to separate; a parameter "
        "to determine better; a cause that this campaign could not show",
        choices=tuple(Need),
    ),
    integer(
        "measurements",
        "total number of further poses or runs for the purpose, with repeats; empty: unknown, or no number is enough",
        minimum=1,
        nullable=True,
    ),
    size(
        "duration_s",
        "s",
        "their duration at the campaign's own pace, without changes of conditions; empty: unknown",
        nullable=True,
    ),
    size(
        "sigma_expected",
        "",
        "expected sigma_now after this and all earlier measurements of the plan, in the unit of its row",
        nullable=True,
    ),
    size(
        "odds_expected",
        "",
        "expected odds of the true rival after this and all earlier measurements of the plan",
        nullable=True,
    ),
    text("expected", "expected result after this and all earlier measurements of the plan", nullable=True),
    text("conditions", "further conditions: approach, pause, pace, surroundings", nullable=True),
    text("channels", "channels to read, separated by blanks"),
    integer("times", "number of repeats; empty: no number is enough", nullable=True),
    real("before", "", "parameter in the earlier campaign, in the unit of its row", nullable=True),
    size("sigma_before", "", "standard deviation of before", nullable=True),
    real("now", "", "parameter by this campaign alone", nullable=True),
    size("sigma_now", "", "standard deviation by this campaign", nullable=True),
    size("sigma_difference", "", "standard deviation of now minus before", nullable=True),
    real("z", "", "now minus before, over its standard deviation", nullable=True),
    real("change", "", "estimated change, if only the parameters marked as changed have changed", nullable=True),
    size("sigma_change", "", "standard deviation of change", nullable=True),
    text("instead", "parameters whose change would explain the data equally well", nullable=True),
    flag("changed", "whether it belongs to the smallest set of parameters whose changes explain all differences"),
    # Comparison of runs.
    integer("place", "position of the run in the order given", minimum=1),
    text("folder", "folder of the run, as given"),
    text("campaign", "campaign of the run; its path, if campaign.toml gives no name"),
    text("group", "kind of number", choices=("geometry", "effect", "compliance", "G_B")),
    real(
        "difference",
        "",
        "the number minus the one that it is compared with: of the previous run, or simulated; in the unit of its row",
        nullable=True,
    ),
    *(
        real(f"missed_{when}", "unit", f"measured minus predicted {when} the extension, in the unit of its row")
        for when in ("before", "after")
    ),
    # Campaigns of one call.
    text("campaign_path", "path of the campaign, as given"),
    integer("exit_code", "exit code of the campaign (docs/running.md)", minimum=0),
    text(
        "campaign_state",
        "state of the campaign's verdict; empty without a verdict",
        nullable=True,
        choices=("ok", "attention", "fails", "not tested"),
    ),
    text("failed_checks", "failed quality checks that nobody accepted, separated by commas", nullable=True),
    integer("problems", "number of faults and other problems that were printed", minimum=0),
    text("problem", "the first of them; empty if there is none", nullable=True),
    text("run_folder", "folder of the run; empty if the campaign did not end", nullable=True),
    integer("stages_run", "number of stages that were not up to date and ran", minimum=0),
    size("processor_s", "s", "processor time of this campaign in this call, in the process that ran it"),
)
