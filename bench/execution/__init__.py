"""Many runs: handed out to processes or a cluster, resumed, kept apart from other drivers."""
