"""Codes of verdicts: reasons for the state of a section, and relations that a diagnosis tests."""

from __future__ import annotations

from enum import StrEnum

CAMPAIGN = "campaign"
# Sections with a row of their own; the first failed one determines the campaign's verdict.
SECTIONS = (
    "belonging",
    "quality",
    "simulation",
    "adequacy",
    "pulls",
    "calibration",
    "transfer",
    "requirements",
    "diagnosis",
    "positioning",
    "changes",
    "poses",
    "deformation",
)
# Sections whose failure means that the data cannot be used unchanged: exit code 3.
GATES = ("belonging", "quality")


class ReasonCode(StrEnum):
    """Reason for the state of a section."""

    BELONG = "belong"
    DEPARTS = "departs"
    DO_NOT_BELONG = "do-not-belong"
    CHECKS_HOLD = "checks-hold"
    CHECK_WARNS = "check-warns"
    CHECK_FAILED = "check-failed"
    WITHIN_NOISE = "within-noise"
    BEYOND_NOISE = "beyond-noise"
    BELOW_NOISE = "below-noise"
    UNDETERMINED_THERE = "undetermined-there"
    LACK_OF_FIT = "lack-of-fit"
    EPOCHS_LEFT_OUT = "epochs-left-out"
    EPOCHS_DEVIATE = "epochs-deviate"
    WITHIN_TOLERANCE = "within-tolerance"
    BEYOND_TOLERANCE = "beyond-tolerance"
    FITS = "fits"
    MISFIT = "misfit"
    CAUSE_LEFT_OUT = "cause-left-out"
    HELD_OUT_MISSED = "held-out-missed"
    PREDICTS_ELSEWHERE = "predicts-elsewhere"
    BEYOND_NOISE_ELSEWHERE = "beyond-noise-elsewhere"
    WORSE_ELSEWHERE = "worse-elsewhere"
    MET = "met"
    UNDECIDED = "undecided"
    NOT_MET = "not-met"
    MODEL_DOES_NOT_FIT = "model-does-not-fit"
    NO_MECHANISM = "no-mechanism"
    NO_READINGS = "no-readings"
    AGREES = "agrees"
    FOUND = "found"
    SUSPECTED = "suspected"
    NOISE = "noise"
    NOTHING_FOUND = "nothing-found"
    NOT_TESTABLE = "not-testable"
    MEASURED = "measured"
    UNCHANGED = "unchanged"
    CHANGED = "changed"
    COMPLETE = "complete"
    POSES_LOST = "poses-lost"
    RIGID = "rigid"
    DEFORMS = "deforms"
    SIMULATION_MISSES = "simulation-misses"
    WITHHELD = "withheld"
    NOT_EVALUATED = "not-evaluated"

    @property
    def meaning(self) -> str:
        """Meaning of the code, as in the reference."""
        return _MEANING[self]

    @property
    def result(self) -> str:
        """``found`` or ``measured`` where the code is a result, which neither passes nor fails; else empty."""
        return _RESULTS.get(self, "")


# Sections whose failure means that a model's parameters are unreliable.
OF_MODEL = ("adequacy", "pulls", "calibration")
# Codes of an incomplete model: effects that it leaves out bias its parameters.
INCOMPLETE = (ReasonCode.BEYOND_NOISE, ReasonCode.LACK_OF_FIT)
# Codes of a model that fits but for single poses or load steps.
OF_SINGLE_EPOCHS = (ReasonCode.EPOCHS_LEFT_OUT, ReasonCode.EPOCHS_DEVIATE)

_RESULTS = {ReasonCode.FOUND: "found", ReasonCode.DEFORMS: "found", ReasonCode.MEASURED: "measured"}
_MEANING = {
    ReasonCode.BELONG: "every tested relation between the tables holds",
    ReasonCode.DEPARTS: "a tested relation holds only in part, or recorded numbers are coarsely rounded",
    ReasonCode.DO_NOT_BELONG: "tables do not belong together; stages that need them are not evaluated",
    ReasonCode.CHECKS_HOLD: "no quality check fails or warns",
    ReasonCode.CHECK_WARNS: "a quality check warns",
    ReasonCode.CHECK_FAILED: "a quality check failed, and no [[accept]] accepts it",
    ReasonCode.WITHIN_NOISE: "no test of the final model finds more than noise; value: rms error over noise floor",
    ReasonCode.BEYOND_NOISE: "residuals exceed noise: larger noise, or an incomplete model; value: rms error over "
    "noise floor",
    ReasonCode.BELOW_NOISE: "residuals are significantly below noise: the declared noise is too large",
    ReasonCode.UNDETERMINED_THERE: "held-out errors exceed noise, but not the uncertainty of the fit: the fitted "
    "data do not determine the model there; value: rms error over that of noise and uncertainty",
    ReasonCode.LACK_OF_FIT: "a test of the residuals fails: the final model is incomplete; value: p-value of the test",
    ReasonCode.EPOCHS_LEFT_OUT: "the model fits, but without poses or load steps at which most values deviate: the "
    "machine or the instrument moved, or a recorded reading is wrong; value: rms error over noise floor",
    ReasonCode.EPOCHS_DEVIATE: "the model fits as a whole, but single poses deviate beyond chance; value: rms error "
    "over noise floor",
    ReasonCode.WITHIN_TOLERANCE: "the pulls as a whole are consistent with tolerances; value: rms pull",
    ReasonCode.BEYOND_TOLERANCE: "the pulls as a whole exceed tolerances (value: rms pull), or those of a single "
    "number do (value: its pull)",
    ReasonCode.FITS: "the chosen calibration passes its tests; value: misfit over noise",
    ReasonCode.MISFIT: "the chosen calibration does not fit its own data; value: misfit over noise",
    ReasonCode.CAUSE_LEFT_OUT: "the chosen calibration does not fit: it leaves out a cause that the diagnosis found",
    ReasonCode.HELD_OUT_MISSED: "the chosen calibration misses held-out data by more than noise",
    ReasonCode.PREDICTS_ELSEWHERE: "a model predicts the second campaign to its noise; value: rms error over noise",
    ReasonCode.BEYOND_NOISE_ELSEWHERE: "every model misses the second campaign by more than noise; value: rms error "
    "over noise",
    ReasonCode.WORSE_ELSEWHERE: "a model predicts the second campaign worse than the nominal one; value: rms error "
    "over the nominal one",
    ReasonCode.MET: "every requirement is met",
    ReasonCode.UNDECIDED: "the interval of an error contains its limit",
    ReasonCode.NOT_MET: "a requirement is not met; value: error over limit",
    ReasonCode.MODEL_DOES_NOT_FIT: "not tested: the model that predicts the errors does not fit",
    ReasonCode.NO_MECHANISM: "readings were recorded, but no [mechanism] relates them to poses",
    ReasonCode.NO_READINGS: "no readings that a simulation relates to poses were recorded",
    ReasonCode.AGREES: "no cause was found, and the residuals are noise",
    ReasonCode.FOUND: "causes were found; value: their number",
    ReasonCode.SUSPECTED: "causes are suspected: plausible, but the model as a whole does not fit; value: their number",
    ReasonCode.NOISE: "the noise is not as declared, and no cause was found",
    ReasonCode.NOTHING_FOUND: "no cause was found, but the residuals are not the declared noise",
    ReasonCode.NOT_TESTABLE: "these data could not show any cause of the catalogue",
    ReasonCode.MEASURED: "a result without a limit",
    ReasonCode.UNCHANGED: "no parameter changed since the earlier model",
    ReasonCode.CHANGED: "parameters changed since the earlier model; value: their number",
    ReasonCode.COMPLETE: "every body has a pose wherever it was measured",
    ReasonCode.POSES_LOST: "bodies lack a pose somewhere; value: their number",
    ReasonCode.RIGID: "no model of deformation explains more than chance, or the simulated one is as measured",
    ReasonCode.DEFORMS: "a body deforms significantly, or its compliance is not symmetric",
    ReasonCode.SIMULATION_MISSES: "the simulated compliance is not as measured; value: p-value of the difference",
    ReasonCode.WITHHELD: "not evaluated, because the data do not belong together",
    ReasonCode.NOT_EVALUATED: "not evaluated: the explanation says why",
}


class Relation(StrEnum):
    """Relation that a search for causes tests."""

    READINGS_POSES = "readings-poses"
    LOADS_READINGS = "loads-readings"
    LOADS_SIGNALS = "loads-signals"
    COMMANDS_ENCODERS = "commands-encoders"
    TARGETS_POSITIONS = "targets-positions"
    JOINTS_LINKS = "joints-links"
    BODIES_SURVEY = "bodies-survey"
    RAYS_POINTS = "rays-points"

    @property
    def is_simulated(self) -> bool:
        """True if a simulation of the machine predicts the relation."""
        return self not in (Relation.BODIES_SURVEY, Relation.RAYS_POINTS)


# Declared noise counts as 50 values: it is known to a tenth (one standard deviation). By chance and by wrongly declared
# noise, a correct model has a misfit beyond _MOST_WRONG once in 1,000 campaigns, by the distribution F(inf, 50).
DECLARED_FREEDOM = 50.0
_UNLIKELY, _MARGIN, _MOST_WRONG = 1e-3, 1.1, 1.42
BY_A_FACTOR = 2.0  # an error above this multiple of the noise fails, because no declared noise is that wrong unnoticed


def does_not_fit(p_value: float, ratio: float) -> bool:
    """True if a model's misfit exceeds what chance and wrongly declared noise explain.

    ``ratio``: rms misfit over declared noise; ``p_value``: probability of such a misfit for a correct model.
    """
    return p_value < _UNLIKELY and ratio > _MOST_WRONG


def is_clearly_larger(p_value: float, ratio: float) -> bool:
    """True if an error exceeds another one by more than a tenth, and beyond chance.

    ``ratio``: error over the other one; ``p_value``: probability of such a ratio where both are equal.
    """
    return p_value < _UNLIKELY and ratio > _MARGIN
