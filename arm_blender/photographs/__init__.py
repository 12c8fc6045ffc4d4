"""Whatever a camera took of an object, to a folder of clean views: cameras, masks, no distortion."""
