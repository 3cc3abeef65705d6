"""Figures, sentences and pages of results, from tables alone."""
