"""The baked gel: what a sensor sees and feels, in milliseconds, each time a rigid object moves (docs/live.md)."""
