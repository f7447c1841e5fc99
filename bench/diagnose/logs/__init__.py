"""What was measured: recordings as the model sees them, the filter they went through, and their noise."""
