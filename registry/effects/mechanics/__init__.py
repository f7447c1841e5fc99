"""Forces and inputs of moving masses: friction, springs, play in a drive."""
