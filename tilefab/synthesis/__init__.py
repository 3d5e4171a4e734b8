"""Offline example-based synthesis: one module a method, one protocol for all."""

from tilefab.synthesis.methods import DEFAULT_METHOD, METHODS
from tilefab.synthesis.protocol import (
    LARGEST_SIDE_PX,
    Step,
    SynthesisMethod,
    SynthesisRequest,
    SynthesisResult,
    Watch,
    render,
)

__all__ = [
    "DEFAULT_METHOD",
    "LARGEST_SIDE_PX",
    "METHODS",
    "Step",
    "SynthesisMethod",
    "SynthesisRequest",
    "SynthesisResult",
    "Watch",
    "render",
]
