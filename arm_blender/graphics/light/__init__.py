"""Light on a surface: the BRDF, environments, spherical harmonics."""
