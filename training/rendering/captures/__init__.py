"""Objects as a camera finds them: on a ground, in surroundings, through a lens; with the truth beside each picture."""
