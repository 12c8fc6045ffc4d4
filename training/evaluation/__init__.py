"""The protocol: assets beside the truth, from the objects to the table."""
