"""Estimation from data alone: rigid poses, robust fits, labels, design. It knows no mechanism and no file."""
