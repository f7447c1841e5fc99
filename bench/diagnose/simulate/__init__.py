"""Free runs: past unmeasured states, to the noise floor, and fits by multiple shooting."""
