"""Training pictures made on the fly: surfaces, materials and lights, without Cycles."""
