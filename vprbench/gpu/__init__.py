"""The check of a GPU against the CPU."""
