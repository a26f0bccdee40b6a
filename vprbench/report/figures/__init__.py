"""Figures, drawn from stored runs; the only package that imports matplotlib."""
