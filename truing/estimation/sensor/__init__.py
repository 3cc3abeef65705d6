"""A force sensor's calibration: from applied loads and recorded signals to a wrench with its uncertainty."""
