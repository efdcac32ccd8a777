"""The paper's experiments and those past it: what is trained, measured and written by `outlast paper`."""
