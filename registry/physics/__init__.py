"""Base physics models: one system a file."""
