"""What practitioners would take from elsewhere, on the same data, windows and measures: one entry a file."""
