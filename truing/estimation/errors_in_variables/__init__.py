"""Errors in variables: implicit models in which every measured quantity has an error."""
