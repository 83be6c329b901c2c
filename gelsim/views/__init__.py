"""Pictures and pages of what there is: a sensor, a dataset, a press, a file."""
