"""Inspecting fired tiles of a job: what a face should look like, what a tile looks like, and what follows from it."""
