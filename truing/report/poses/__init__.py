"""The section of the poses and their uncertainty."""
