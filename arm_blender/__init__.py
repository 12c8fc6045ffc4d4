"""ARM for Blender: from pictures of an object to a textured, relightable mesh."""
