"""What was added from the two papers, compared by command line with generators and calculators written a second time.

The modules without ``test_`` hold physics from the papers in plain numpy and scipy; they share no code with ``truing``.
"""
