"""Offline example-based synthesis: one module a method, one protocol for all."""

from tilefab.synthesis.protocol import METHODS, SynthesisMethod, SynthesisRequest, SynthesisResult

__all__ = ["METHODS", "SynthesisMethod", "SynthesisRequest", "SynthesisResult"]
