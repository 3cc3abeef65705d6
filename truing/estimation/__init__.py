"""What data say: rigid poses, robust fits, labels, evidence. It knows no mechanism and no file."""
