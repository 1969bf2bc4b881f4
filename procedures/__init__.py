"""Procedures that come with the bench: a script each, or a folder of one with its parts; also examples."""
