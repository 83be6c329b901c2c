"""The coated outer face of the gel: its smooth surface from a press, and the markers on it."""
