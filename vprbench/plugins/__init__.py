"""Plug-ins: found, built from options, checked, and their stored networks."""
