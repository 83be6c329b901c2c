"""The baked gel: what a sensor sees and feels, each time a rigid object moves (docs/live.md)."""
