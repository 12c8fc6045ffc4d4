"""The networks of the paper, and of those that it builds on (ARM, sections 3 to 5)."""
