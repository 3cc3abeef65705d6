"""Calibration of a force sensor: from applied loads and recorded signals to a wrench with its uncertainty."""
