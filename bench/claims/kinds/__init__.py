"""What a claim can be: each kind finds its numbers in the evidence; `bench.claims.estimate` makes the verdict."""
