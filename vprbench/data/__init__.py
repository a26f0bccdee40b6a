"""Frames: fetched and checked."""
