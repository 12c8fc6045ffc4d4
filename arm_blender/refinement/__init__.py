"""A reconstructed mesh moved until it meets its pictures: their outlines, and what of their colours agrees.

`refine` tells the story. The shape networks know an object to about one cell of their volume; the pictures know it ten
times better, wherever they see it. Lengths are those of the box [-1, 1]^3.
"""
