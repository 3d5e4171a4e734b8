"""Every synthesis method by the name that job files and commands call it."""

from __future__ import annotations

from collections.abc import Mapping

from tilefab.synthesis.graphcut import graphcut
from tilefab.synthesis.protocol import SynthesisMethod
from tilefab.synthesis.quilting import quilt
from tilefab.synthesis.self_tuning import self_tuning
from tilefab.synthesis.uniform import uniform

METHODS: Mapping[str, SynthesisMethod] = {
    "quilting": quilt,
    "graphcut": graphcut,
    "self-tuning": self_tuning,
    "uniform": uniform,
}
"""Every synthesis method by its name."""

DEFAULT_METHOD = "self-tuning"
"""The method where none is named."""
