"""Datasets: a plan becomes thousands of episodes, in worker processes, and goes on where it was killed."""

from gelsim.generate.run import Extent, Hands, generate, summary

__all__ = ["Extent", "Hands", "generate", "summary"]
