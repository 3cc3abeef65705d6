"""Blind tests: campaigns with hidden effects, which the pipeline must find and name."""
