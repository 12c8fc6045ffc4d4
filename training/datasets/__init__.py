"""Samples that the stages of the training draw from shards."""
