"""From a scene to files: the stages, the fidelity that is chosen, what is written."""
