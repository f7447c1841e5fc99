"""A published number → reproduced, differs, alike, not enough evidence, not run; claims are data, evidence a table."""
