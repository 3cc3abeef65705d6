"""What was measured more than once: pure error, and whether the models leave more than that."""
