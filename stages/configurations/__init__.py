"""The choice of configurations: the problem, the search, the words."""
