"""Logs of autopilots and robots, each in the format of its maker."""
