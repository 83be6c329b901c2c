"""The command line: `main` has the commands, `flags` makes them of the scene's fields, `doctor` says what this machine can run."""
