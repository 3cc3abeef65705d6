"""Open kinematic chains: serial arms, gantries and trees of revolute and prismatic joints."""
