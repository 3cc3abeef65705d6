"""Choice of configurations: problem, search, words."""
