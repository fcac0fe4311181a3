"""Responses from samples: frequency responses, resonance correction, averaging, steps, cycles, breakdown.

Pure functions of `schemas.recording.Recording` and arrays. Models fitted to responses are in `pipeline.fit`.
"""
