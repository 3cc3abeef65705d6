"""A loaded sensor: its displacement, predicted readings and wrenches."""
