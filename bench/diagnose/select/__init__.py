"""Which effects explain what a model leaves: search, subsets, and what speaks against a choice."""
