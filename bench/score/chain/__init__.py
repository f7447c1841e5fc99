"""A second simulator of flights, which shares no code with the first: another vehicle, pilot, motor, air and logger."""
