"""Environments: worlds for people, learners and the command line.

Here is what all of them stand on. Read in this order: scenario and variants (which game), vector (many worlds of it,
stepped together), spaces (what is seen and done), policies and rollout, render and views/ (pictures). Then, each in a
folder of its own: faces/ (the same worlds for other libraries), recording/ (runs that are repeated to the bit), film/,
page/ (a recording in the browser), play/ (a person steers), commands/ (the command line).
"""
