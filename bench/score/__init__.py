"""Independent flights with known hidden effects, and the score of a diagnosis on them."""
