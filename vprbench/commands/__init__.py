"""The commands: one function each, a run, and the help of all."""
