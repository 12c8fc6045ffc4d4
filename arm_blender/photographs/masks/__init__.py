"""The masks of one object in many pictures: what they have in common, and what the cameras tell about them."""
