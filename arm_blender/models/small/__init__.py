"""The networks that ship: sized for a laptop's processor, and not in the paper."""
