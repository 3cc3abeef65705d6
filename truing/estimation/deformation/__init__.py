"""How attachments and targets shift: against actuators, drives and loads, with what their points have in common."""
