"""Every synthesis method by the name that job files and commands call it."""

from __future__ import annotations

from collections.abc import Mapping

from tilefab.synthesis.graphcut import graphcut
from tilefab.synthesis.protocol import SynthesisMethod
from tilefab.synthesis.quilting import quilt

METHODS: Mapping[str, SynthesisMethod] = {"quilting": quilt, "graphcut": graphcut}
"""Every synthesis method by its name."""

DEFAULT_METHOD = "quilting"
"""The method where none is named."""
