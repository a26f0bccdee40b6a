"""The face for Python programs and notebooks: runs, their results and comparisons as objects, in this process."""
