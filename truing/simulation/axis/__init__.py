"""One rotary or linear axis: what its encoders and an outside instrument record at commanded positions."""
