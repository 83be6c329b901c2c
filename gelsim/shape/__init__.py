"""What is pressed: parametric solids and mesh files, exact surfaces, symmetry, placement."""
