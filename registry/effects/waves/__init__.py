"""What swings at one frequency, whatever the system does."""
