"""Zero123++ (arXiv:2310.15110): six views from one picture, by a diffusion model whose weights the user brings."""
