"""Targets in photographs: where they are, to a hundredth of a pixel with covariance, and what they say they are."""
