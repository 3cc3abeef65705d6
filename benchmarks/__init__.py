"""Side by side with other libraries, in one run; figures and how they were taken are in README.md."""
