"""What decisions depend on: steepness and costs of the reward, discount, belief, tables."""
