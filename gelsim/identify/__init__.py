"""An object's modulus from the video of a press, by the mechanics and the light of the sensor instead of a network: `run.identify`."""
