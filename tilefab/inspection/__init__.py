"""Fired tiles: found in an image, recognised by their own pattern, measured against their own face, and judged."""
