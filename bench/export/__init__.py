"""Models as files that other programs take: numpy, CasADi."""
