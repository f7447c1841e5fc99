"""Whether dataset.toml reads a log as it was written: signs, axes, units, frames, orders, clocks, mounting, rate."""
