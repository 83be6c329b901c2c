"""What is solved on: solids of gel and object, profiles of both, their sizes, and which part of a press needs no solid at all."""
