"""What physics predicts: mechanisms, their kinematics, and the causes that change them. Knows no data."""
