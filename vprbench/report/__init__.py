"""Stored runs become tables, figures and a page."""
