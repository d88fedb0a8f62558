"""Files in and files out: one small module for each medium."""
