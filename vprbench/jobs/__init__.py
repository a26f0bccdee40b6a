"""Runs made here one after the other, or side by side on dask, which no other room knows."""
