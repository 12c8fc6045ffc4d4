"""What the artist sets regions of an asset to: the part "Materials" of the "ARM" tab, and what it calls."""
