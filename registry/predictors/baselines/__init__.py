"""What a network is judged beside: nothing in them is learnt by gradient."""
