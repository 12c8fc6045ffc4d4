"""One module a stage of the training: what is fitted, on which samples, by which loss."""
