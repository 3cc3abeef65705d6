"""Targets in photographs: image coordinates to a hundredth of a pixel with covariance, and decoded names."""
