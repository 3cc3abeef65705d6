"""Independent second implementations of features from the two papers, compared through the command line.

The modules without ``test_`` hold physics from the papers in plain numpy and scipy; they share no code with ``truing``.
"""
