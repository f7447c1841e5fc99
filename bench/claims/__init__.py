"""A published number → reproduced / differs / not enough evidence / not run; claims are data, evidence is a table."""
