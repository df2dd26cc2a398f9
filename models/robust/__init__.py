"""What the robot should do given doubt: weighted draws of the dynamics feed the planner."""
