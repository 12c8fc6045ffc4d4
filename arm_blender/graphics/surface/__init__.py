"""Densities to triangles: where to sample, marching cubes, fairing."""
