"""The token game of the studies: rules, layouts, the robot's and a simulated person's play, records."""
