"""What is measured against: the objects, their views and how they were rendered."""
