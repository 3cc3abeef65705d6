"""The section of the deformation: picture, figures, models."""
