"""Planning: what the robot should do, with a proof of how good the answer is."""
