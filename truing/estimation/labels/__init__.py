"""Labels of measured points: assignment of unlabelled points to targets, exchanged labels, gross errors."""
