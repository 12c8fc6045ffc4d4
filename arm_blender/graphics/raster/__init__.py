"""Triangles to pixels: fragments, their gradients, rays."""
