"""Stored runs become Table II, figures and a page."""
