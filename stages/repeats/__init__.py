"""Repeated measurements: pure error, and lack of fit of the models."""
