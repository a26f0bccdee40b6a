"""Stored runs become rows, and rows become Markdown, CSV, LaTeX and HTML."""
