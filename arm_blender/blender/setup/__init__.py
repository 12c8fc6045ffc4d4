"""The preferences: libraries, weights, folders, device; and what they put into effect."""
