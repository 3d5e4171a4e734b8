"""tilefab prints stone on ceramic tile: a different, re-creatable face on every tile of a run."""

__version__ = "0.1.0"
