"""Statistics of the deformation models in words: the column ``figure`` of deformation_errors.parquet on the page."""

from __future__ import annotations

_SETS = {"cv_": ", each pose or run predicted from the others", "verification_": ", held-out data"}
_SIZES = {"max_error": "largest error", "mean_error": "mean absolute error", "rms_error": "rms error"}
_WORDS = {
    "noise_ratio": "residuals over their declared noise (rms)",
    "p_value_over_none": "p: the model explains nothing",
    "p_value_over_linear": "p: the matrix explains no more than its diagonal",
    "modulo_plane": "known except for a common plane (1: yes)",
    "rank": "independent shapes above noise",
    "asymmetry": "antisymmetric part over the whole matrix",
    "symmetry_p_value": "p: the matrix is symmetric",
    "coupling": "coupling of the two legs (rms of both entries)",
    "coupling_p_value": "p: the two legs are not coupled",
    "share_lift": "lift, share of the mean square shift",
    "share_tilt": "tilt, share of the mean square shift",
    "share_buckle": "buckling of the ring, share of the mean square shift",
    "share_principal": "dominant shape, share of the mean square shift",
    "principal_amplitude": "dominant shape, amplitude",
    "principal_shape": "dominant shape, relative shift of this leg",
    "rms_shift": "rms shift along x and y",
    "rms_left": "rms shift along x and y that actuators do not explain",
    "rms_following": "rms shift per axis that follows the actuators",
    "rms_following_upper": "rms shift per axis that follows the actuators, upper 95 % limit",
    "rms_detectable": "rms shift per axis that would be found with 95 % probability",
    "r_squared": "share of the variance explained (R²)",
    "agreement_p_value": "p: measured and simulated entries agree",
    "agreement_chi_square": "chi-square of measured minus simulated entries",
    "agreement_without_plane_p_value": "p: measured and simulated entries agree, except for a common plane",
    "entries_compared": "independent entries compared",
    "measured_over_simulated": "measured over simulated, common factor",
    "measured_over_simulated_sigma": "measured over simulated, standard deviation of the factor",
    "scaled_p_value": "p: entries agree after this common factor",
    "branch_gap": "largest difference between loading and unloading",
    "branch_gap_p_value": "p: no difference between loading and unloading",
}


def error_figure_words(figure: str) -> str:
    """Name of a statistic in words; unknown names with spaces for their underscores."""
    for prefix, data in _SETS.items():
        if figure.startswith(prefix):
            return error_figure_words(figure.removeprefix(prefix)) + data
    return _SIZES.get(figure) or _WORDS.get(figure) or figure.replace("_", " ")
