"""Measuring and matching texture: patch search, minimum cuts, and how alike two faces are."""
