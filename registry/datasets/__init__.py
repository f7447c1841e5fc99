"""Recordings of real and simulated systems: one source a file."""
