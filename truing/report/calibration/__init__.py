"""The section of the calibrations and requirements: figures, tables, words."""
