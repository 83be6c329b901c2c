"""gelsim: a tactile simulator that joins contact finite elements with light transport."""
