"""Benchmarks of system identification: one a file."""
