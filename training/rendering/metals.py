"""What real metals look like."""

METALS = (
    (1.0, 0.86, 0.57),
    (0.96, 0.64, 0.54),
    (0.91, 0.92, 0.92),
    (0.56, 0.57, 0.58),
    (0.95, 0.93, 0.88),
    (0.89, 0.79, 0.55),
)
"""Linear base colours of gold, copper, aluminium, iron, silver and brass (normal-incidence reflectance)."""
