"""Shafts of light and shadow through air and fog: the algorithms, each in a file of its own."""
