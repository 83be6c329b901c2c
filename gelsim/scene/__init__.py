"""What is to be simulated: fields and their limits, materials, the layers that a scene is made of, distributions to draw it from."""
