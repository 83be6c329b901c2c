"""What is kept and read again: episodes of a dataset, motion archives, light fields, and how far two pictures are apart. No simulator."""
