"""Models of what the structure of a mechanism adds to rigid legs."""
