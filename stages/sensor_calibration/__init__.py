"""The calibration of a force sensor: from its drawing to G, from signals to G_B, and the errors that are left."""
