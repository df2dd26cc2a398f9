"""Plots: one idea a file, one style for all; every function draws on the axes it is given and returns them."""
