"""What a run leaves, in the forms that others read: each export is a function of a run, giving files by name."""
