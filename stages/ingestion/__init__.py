"""Conversion of input files to points and configurations in standard units, with checks."""
