"""Weights on disk: what is known, read, checked, brought from other projects and installed."""
