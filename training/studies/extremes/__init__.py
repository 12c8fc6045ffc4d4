"""Parts of the pipeline on inputs that are harsher than a scene should bring."""
