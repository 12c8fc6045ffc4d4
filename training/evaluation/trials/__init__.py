"""What is measured: our pipeline, its baselines, other systems."""
