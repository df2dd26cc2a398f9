"""Plots: one idea a file, one style for all; every function draws on the axes it is given and returns them.

A plot function takes `ax=None` as a keyword and returns what it drew on. One panel: `Axes` in, the same out.
Several panels: an array of `Axes` in, of the shape that its docstring names, and the same out as `Panels`, which
has `figure` and `axes`; an array of another shape is refused with the shape wanted. Without `ax` the function
makes a figure of its own in the one style (`analysis.figures.style`). There, words and legends of all panels
stand at the edges; where axes are given they stand at the panels themselves, since other plots may share that
figure. Nothing touches pyplot or the global settings. Axes are named from one vocabulary
(`analysis.figures.axis_names`), as quantity and unit in parentheses.
"""
