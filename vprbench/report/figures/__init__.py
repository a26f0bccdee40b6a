"""Figures of the paper and beyond, drawn from stored runs; the only package that imports matplotlib."""
