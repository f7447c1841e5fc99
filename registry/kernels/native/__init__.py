"""The numeric core in C++: compiled on first use, loaded by ctypes."""
