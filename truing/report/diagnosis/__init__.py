"""The section of the diagnosis, and how a finding is said."""
