"""Where a state is not measured: sets of effects that are fitted and compared by simulation."""
