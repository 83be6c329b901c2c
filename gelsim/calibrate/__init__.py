"""From photographs of a pressed ball to a sensor preset, by differentiable rendering (docs/calibrate.md)."""

from gelsim.calibrate.run import calibrate, summary

__all__ = ["calibrate", "summary"]
