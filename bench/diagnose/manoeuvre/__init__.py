"""Manoeuvres that tell candidates apart: what may be driven how far, how it is flown, and what it would show."""
