"""Cameras solved from the photographs themselves: attempts, and how far each is to be trusted."""
