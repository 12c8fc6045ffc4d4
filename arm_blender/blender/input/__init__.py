"""What the user chooses: views, cameras of the scene, a mesh of his own; read into a request."""
